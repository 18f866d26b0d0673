"""Everything that can go wrong, in one family.

    MicrobundleError            exit code 1
    +-- ConfigError             2   a setting that is not allowed, or a wrong command line
    +-- MovieUnreadable         4   the movie, or a file given with it, cannot be read
    |   +-- ChoiceMissing       4   a file holds several series, channels or focal planes, and none was chosen
    |   +-- MaskUnusable        4   a supplied mask does not fit the movie, or marks nothing
    |   +-- ResultUnreadable    4   a result file cannot be read
    +-- CannotMeasure           5   the movie was read, but what was asked cannot be measured on it
    |   +-- NoTissue            5   no tissue was found that a mask could be trusted on
    |   +-- NoPillars           5   no pillar was found that a mask could be trusted on
    |   +-- NoTexture           5   the tissue shows too few points that can be followed
    |   +-- CalibrationMissing  5   a physical unit was asked for and the scale is not known
    +-- OutputError             6   the results cannot be written
    +-- ClusterUnusable         7   the cluster that should measure cannot be reached or used, or was lost

Exit code 3 is not an error: the result was written and its verdict is "fail" (for example no measurable motion).
"""


class MicrobundleError(Exception):
    """Base of every error that microbundle raises on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class ConfigError(MicrobundleError):
    """A setting is unknown, of the wrong type, or out of its range."""

    exit_code = 2


class MovieUnreadable(MicrobundleError):
    """A movie, or a file given with it, is missing, damaged, or of a kind that cannot be read."""

    exit_code = 4


class ChoiceMissing(MovieUnreadable):
    """A file holds several series, channels or focal planes; the message lists them and says how to choose."""


class MaskUnusable(MovieUnreadable):
    """A supplied mask has another shape than the frames, holds other values than 0 and 1 or 255, or is empty."""


class ResultUnreadable(MovieUnreadable):
    """A file is not a result that microbundle wrote, or is damaged."""


class CannotMeasure(MicrobundleError):
    """The movie was read, but it does not allow the measurement; the message says why and what would."""

    exit_code = 5


class NoTissue(CannotMeasure):
    """No region of the picture can be taken for the tissue."""


class NoPillars(CannotMeasure):
    """No part of the picture can be taken for a pillar, and no pillar mask came with the movie."""


class NoTexture(CannotMeasure):
    """The tissue shows too few points that can be recognised from frame to frame."""


class CalibrationMissing(CannotMeasure):
    """A physical unit was asked for, and the pixel size or the time between frames is not known."""


class OutputError(MicrobundleError):
    """The results cannot be written where they were asked for."""

    exit_code = 6


class ClusterUnusable(MicrobundleError):
    """The scheduler of a cluster cannot be reached or was lost, or none of its workers can do the work."""

    exit_code = 7
