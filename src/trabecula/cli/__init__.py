"""The command line: one file per verb, each thin. Nothing heavy is imported before a verb runs."""
