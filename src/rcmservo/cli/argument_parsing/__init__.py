"""From the words of a command line to the dataclass of its options, with help and messages.

No option is defined here: the options of a command are the fields of its dataclass (see cli.py).
"""
