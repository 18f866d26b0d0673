"""The app: a page in the browser, on this computer alone, that does what the command line does.

    microbundle app plate_1

`commands` starts it, `server` serves it, `guard` lets nobody else in. `places` are the folders a person may look into,
`uploads` what was dropped, `runs` the runs (each a batch run of the command line, in a process of its own), `records`
what is kept of them, `process` and `progress` how they are started and followed, `run_view` how they are told.
`frames`, `masks`, `results`, `clicks` and `review` are about single movies. `routes` and its sisters answer requests;
`desk` holds all of it together.
"""
