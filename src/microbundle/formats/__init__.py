"""Every kind of file a movie comes in: one module each, chosen by the file's first bytes, not by its name.

Each module has two functions: `contents(file)` says what is inside, and `open_movie(file, selection)` gives the frames
of one series, channel and focal plane, decoded on demand. Libraries of the instruments' formats are imported when such
a file is opened.
"""
