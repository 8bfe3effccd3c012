"""The four papers as they stand: the worlds, experiments, tables and figures of each, beside ours."""
