"""The command line: find the command, run it, and turn errors into one sentence and an exit code.

Exit codes: 0 done; 2 wrong command line or settings; 3 result written, but its verdict is "fail"; 4 movie or mask
cannot be read; 5 movie cannot be measured; 6 results cannot be written; 130 interrupted.
"""

from __future__ import annotations

import os
import sys

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter, UnusedCliTokensError

from .errors import ConfigError, MicrobundleError

INTERRUPTED = 130

app = App(name="microbundle", help="Displacement, strain and beat metrics from movies of cardiac microbundles.",
          version_flags=["--version"], help_format="plaintext", default_parameter=Parameter(negative_iterable=()),
          suppress_keyboard_interrupt=False)
app.command("microbundle.commands:analyze", name="analyze", help="Measure one movie and write a folder of results.")
app.command("microbundle.batch.commands:batch", name="batch", help="Measure many movies, resume where that was "
            "stopped, and write tables over all of them.")
app.command("microbundle.statistics.commands:compare", name="compare", help="Compare the wells of a run over many "
            "movies: groups, before and after, doses.")
app.command("microbundle.web.commands:app", name="app", help="Open the app: a page in the browser, on this computer "
            "alone, that does what the command line does.")
app.command("microbundle.commands:info", name="info", help="Show what is inside a movie file or folder, and what would "
            "be taken from it.")
app.command("microbundle.commands:decide", name="decide", help="Write down what a person decides about a movie: beats, "
            "mask, settings, accepted or not.")
app.command("microbundle.commands:trace", name="trace", help="Measure the beats of a trace, such as calcium, and the "
            "delay of the contraction.")
app.command("microbundle.commands:metrics", name="metrics", help="Print the dictionary of metrics: every key with its "
            "unit and definition, or all about one.")
app.command("microbundle.commands:export", name="export", help="Write a result in another layout.")
app.command("microbundle.commands:report", name="report", help="Write the report of a result again, from its result "
            "file alone.")
app.command("microbundle.commands:demo", name="demo", help="Render a small beating tissue with known motion, analyze "
            "it, and print what was measured beside the truth.")
app.command("microbundle.synth.commands:simulate", name="simulate", help="Render a movie with exactly known motion, in "
            "the paper's layout, with its truth beside it.")
app.command("microbundle.synth.commands:example_plate", name="example-plate", help="Render a plate of small movies "
            "with known truth, to try `batch` on.")
app.command("microbundle.synth.commands:validate", name="validate", help="Measure the pipeline's error on movies whose "
            "motion is known, or on your own texture.")
app.command("microbundle.synth.commands:compare_clicks", name="compare-clicks", help="Compare a result with points "
            "that people followed by hand.")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code; a user never sees a traceback for bad input."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code."""
    as_json = any(argument == "--json" or argument.startswith("--json=") for argument in arguments)
    _silence_libraries()
    try:
        code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except BrokenPipeError:
        # Who reads the output, such as `head`, wants no more of it; Python would complain once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MicrobundleError as error:
        return _fail(str(error), type(error).__name__, error.exit_code, as_json)
    except CycloptsError as error:
        return _fail(_sentence(error), ConfigError.__name__, ConfigError.exit_code, as_json)
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was written", KeyboardInterrupt.__name__, INTERRUPTED, as_json)


def _silence_libraries() -> None:
    """Keep remarks about damaged files off the error stream: what matters in them becomes one of our errors."""
    import logging

    for name in ("tifffile", "czifile", "liffile", "nd2"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _sentence(error: CycloptsError) -> str:
    """Say in one sentence what is wrong with a command line."""
    cause = error.__cause__ or error.__context__
    if type(cause).__module__.startswith("pydantic"):
        from .config import explain

        return explain(cause, "command line")  # type: ignore[arg-type]
    if isinstance(error, UnusedCliTokensError):
        return f"command line: expected nothing after the movie or result; found {' '.join(error.unused_tokens or [])}"
    if isinstance(error, MissingArgumentError) and error.argument is not None and error.argument.required:
        name = error.argument.name
        shown = name if error.argument.index is None else name.lstrip("-").upper()
        return f"command line: {shown} is missing; `microbundle {' '.join(error.command_chain or ())} --help` shows how"
    error.verbose = False
    return f"command line: {str(error).strip()}"


def _fail(message: str, kind: str, code: int, as_json: bool) -> int:
    """Print an error: on the error stream, and for `--json` as the one JSON object of the output."""
    if as_json:
        import json

        print(json.dumps({"error": {"kind": kind, "message": message, "exit_code": code}}))
    print(f"error: {message}", file=sys.stderr)
    return code
