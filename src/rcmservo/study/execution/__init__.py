"""Execution of a study: chunks of runs on local processes or a cluster, and their storage."""
