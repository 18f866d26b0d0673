"""Write a folder whole or not at all, and never in place of anything that is not ours.

A folder is filled beside its final place under a temporary name, and renamed when it is complete. It gets a list of the
files in it (`microbundle.json`); only a folder that holds such a list, and nothing that is not on it, is ever replaced.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from .errors import OutputError

LIST = "microbundle.json"
LEFT_BY_SYSTEM = {".DS_Store", "Thumbs.db", "desktop.ini"}
"""Files that file managers leave behind; they go with the folder."""


def write_whole(folder: Path, kind: str, write: Callable[[Path], None], *, overwrite: bool = False) -> Path:
    """Let `write` fill a temporary folder, and give it its name when it is complete; returns its full path.

    `kind` names what it holds, such as "results". Raises OutputError where the folder exists and may not be replaced
    (see `check_free`), or writing fails; nothing is left then.
    """
    folder = check_free(folder, kind, overwrite)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.partial-", dir=folder.parent))
    except OSError as error:
        raise _unwritable(folder, error) from None
    try:
        partial.chmod(0o755)
        write(partial)
        listed = {"kind": kind, "files": sorted(_files(partial))}
        (partial / LIST).write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
        check_free(folder, kind, overwrite)
        _swap(partial, folder)
    except OSError as error:
        raise _unwritable(folder, error) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def check_free(folder: Path | str, kind: str, overwrite: bool = False) -> Path:
    """Check that a folder may be written, and return its full path.

    It may where it does not exist or is empty; with `overwrite` also where it is a folder of the same kind that
    microbundle wrote, and holds nothing else. Raises OutputError, and never changes anything.
    """
    folder = Path(folder).expanduser()
    try:
        folder = folder.resolve()
        if not folder.exists():
            return folder
        if not folder.is_dir():
            raise OutputError(f"{folder}: expected a folder for the {kind}; there is a file of that name")
        if Path.cwd().is_relative_to(folder):
            raise OutputError(f"{folder}: expected a new folder for the {kind}; this is the folder you work in")
        found = _files(folder)
        if not found:
            return folder
        old_kind, ours = _listed(folder)
        foreign = sorted(name for name in found - ours if name.rpartition("/")[2] not in LEFT_BY_SYSTEM)
    except (OSError, RuntimeError) as error:  # a loop of links is a RuntimeError
        raise _unwritable(folder, error) from None
    if old_kind != kind or foreign:
        example = f", such as {foreign[0]}" if foreign else f" ({old_kind})"
        raise OutputError(f"{folder}: expected a new or empty folder for the {kind}; it holds something else{example}, "
                          "which is never replaced. Choose another with --out")
    if not overwrite:
        raise OutputError(f"{folder}: holds {kind} already. Replace them with --overwrite, or choose another folder "
                          "with --out")
    return folder


def remove_whole(folder: Path, kind: str) -> bool:
    """Remove a folder of this kind that microbundle wrote; one that holds anything else stays, and False is returned.

    Raises OSError.
    """
    try:
        check_free(folder, kind, overwrite=True)
    except OutputError:
        return False
    shutil.rmtree(folder)
    return True


def write_file(file: Path, content: str, *, mark: str, overwrite: bool = False) -> Path:
    """Write a file whole or not at all, and list it where it comes into a folder that we wrote; returns its full path.

    With `overwrite` an older file is replaced, but only one that holds `mark` near its start. Raises OutputError where
    the file exists and may not be replaced, or cannot be written; nothing is left then.
    """
    file = Path(file).expanduser()
    partial = None
    try:
        file = file.resolve()
        if file.exists():
            _check_ours(file, mark, overwrite)
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=f".{file.name}.partial-", dir=file.parent)
        with open(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(content)
        Path(partial).chmod(0o644)
        os.replace(partial, file)
        partial = None
        _add_to_list(file)
    except (OSError, RuntimeError) as error:  # a loop of links is a RuntimeError
        raise OutputError(f"{file}: the file cannot be written: {getattr(error, 'strerror', None) or error}") from None
    finally:
        if partial is not None:
            Path(partial).unlink(missing_ok=True)
    return file


def write_within(folder: Path, name: str, write: Callable[[Path], object]) -> None:
    """Let `write` make a file or a folder, put it whole into a folder that we wrote, in place of an older one of that
    name, and list it there.

    `write` is given the path at which it is to be made. A run that is killed in between leaves a list of more than
    there is, with which the folder can still be replaced. Raises OutputError where the folder is none of ours, or
    writing fails; the older one is in place then.
    """
    try:
        kind, ours = _listed(folder)
        if not kind:
            raise OutputError(f"{folder}: expected a folder with its list of files, {LIST}; there is none")
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.{name}.partial-", dir=folder.parent))
        try:
            write(aside / name)
            new = {f"{name}/{inner}" for inner in _files(aside / name)} if (aside / name).is_dir() else {name}
            kept = {one for one in ours if one != name and not one.startswith(f"{name}/")}
            _write_list(folder, kind, ours | new)
            if (folder / name).exists():
                (folder / name).rename(aside / f"{name}.old")
            (aside / name).rename(folder / name)
            _write_list(folder, kind, kept | new)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise _unwritable(folder, error) from None


def _check_ours(file: Path, mark: str, overwrite: bool) -> None:
    if not file.is_file():
        raise OutputError(f"{file}: expected a new file; there is a folder of that name. Choose another with --out")
    with file.open("rb") as stream:
        start = stream.read(4096)
    if mark.encode() not in start:
        raise OutputError(f"{file}: expected a new file; there is another file, which is never replaced. Choose "
                          "another with --out")
    if not overwrite:
        raise OutputError(f"{file}: exists already. Replace it with --overwrite, or choose another with --out")


def _add_to_list(file: Path) -> None:
    """Add a file to the list of the folder that it lies in, so that the folder can still be replaced as a whole."""
    old_kind, ours = _listed(file.parent)
    if not old_kind or file.name in ours:
        return
    _write_list(file.parent, old_kind, ours | {file.name})


def _write_list(folder: Path, kind: str, files: set[str]) -> None:
    partial = folder / f".{LIST}.partial"
    partial.write_text(json.dumps({"kind": kind, "files": sorted(files - {LIST})}, indent=1) + "\n", encoding="utf-8")
    partial.replace(folder / LIST)


def _listed(folder: Path) -> tuple[str, set[str]]:
    """Read the kind of a folder that we wrote, and what is in it; nothing for any other folder."""
    with suppress(ValueError, KeyError, TypeError, FileNotFoundError):
        listed = json.loads((folder / LIST).read_text(encoding="utf-8"))
        return str(listed["kind"]), {LIST, *map(str, listed["files"])}
    return "", set()


def _files(folder: Path) -> set[str]:
    """Names of all files below a folder, and of its folders that are empty, with `/` between the parts."""
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*")
            if file.is_symlink() or not file.is_dir() or not any(file.iterdir())}


def _swap(partial: Path, folder: Path) -> None:
    """Put the complete folder in place; an older one steps aside first, and comes back if that fails."""
    if not folder.exists():
        partial.rename(folder)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old-", dir=folder.parent))
    try:
        folder.rename(aside / folder.name)
        try:
            partial.rename(folder)
        except BaseException:
            (aside / folder.name).rename(folder)
            raise
    except BaseException:
        with suppress(OSError):
            aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _unwritable(folder: Path, error: Exception) -> OutputError:
    reason = error.strerror if isinstance(error, OSError) else None
    return OutputError(f"{folder}: the folder cannot be written: {reason or error}")
