"""The command `app`: it starts the server and waits until that is stopped; `cli` registers it."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..commands import Switch
from ..errors import ConfigError

NEEDED = ("starlette", "uvicorn", "jinja2", "python_multipart")
WORKSPACE = Path("microbundle_app")


def app(folders: Annotated[list[Path] | None, Parameter(name="FOLDERS", consume_multiple=True)] = None, /, *,
        workspace: Path = WORKSPACE, port: int | None = None, no_browser: Switch = False, quiet: Switch = False) -> int:
    """Open the app: a page in the browser, on this computer alone, that does what the command line does.

    Parameters
    ----------
    folders
        Folders to open movies from, which are only read; by default the current folder.
    workspace
        Folder for the app's own files and all results; by default microbundle_app in the current folder.
    port
        Port of this computer to answer at; by default that of last time, or a free one.
    no_browser
        Print the address, and open no browser.
    quiet
        Print nothing but errors.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ConfigError(f'app: needs other packages ({", ".join(missing)}): pip install "microbundle[web]"')
    from .server import serve

    return serve(folders or [Path()], workspace, port=port, browser=not no_browser, quiet=quiet)
