"""Many movies: plan them, measure each in a process of its own kind, lose nothing, and collect the numbers.

    from microbundle.batch.plan import make_plan
    from microbundle.batch.run import run_batch
    plan = make_plan("plate_1", pattern="{plate}_{well}")
    run_batch(plan, "plate_1_results", workers=2)

`find`, `manifest` and `names` say which movies there are and what is known of them; `plan` makes tasks of them; `work`
measures one movie in a worker; `state` keeps what became of it; `run` brings all together; `collect` writes the tables.
Processes are spawned: a script that calls `run_batch` does so under `if __name__ == "__main__":`.
"""
