"""Commands of `rcmservo`, one file each.

The table of the commands is in cli.py. The options of a command are the fields of its dataclass,
which is in the file of the command, or in run_options.py for `run`, `live` and `serve`.
"""
