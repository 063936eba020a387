"""Marks for tests of external programs, and a table at the end of the programs that were tested.

A test whose program is not installed is skipped with the command that installs it. With
RCMSERVO_PEERS set to "all", as in CI, it fails instead.
"""

import os
from collections import Counter
from typing import Any

import pytest


def mark_peer(name: str, installed: bool, command: str) -> pytest.MarkDecorator:
    """Return the mark of tests that need an external program, for one test or as `pytestmark`.

    `command` installs the program.
    """
    return pytest.mark.peer(name=name, installed=installed, command=command)


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("peer"):
        item.user_properties.append(("peer", mark.kwargs["name"]))
        if not mark.kwargs["installed"]:
            _skip_or_fail("{name} is not installed: {command}".format(**mark.kwargs))


def _skip_or_fail(sentence: str) -> None:
    if os.environ.get("RCMSERVO_PEERS") == "all":
        pytest.fail(sentence, pytrace=False)
    pytest.skip(sentence)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    outcomes: dict[str, Counter[str]] = {}
    for report in (one for some in terminalreporter.stats.values() for one in some):
        if getattr(report, "when", "") == "call" or getattr(report, "outcome", "") != "passed":
            for key, name in getattr(report, "user_properties", ()):
                if key == "peer":
                    outcomes.setdefault(name, Counter())[report.outcome] += 1
    if not outcomes:
        return
    terminalreporter.section("peers")
    for name, counts in sorted(outcomes.items()):
        summary = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        terminalreporter.line(f"{name}: {summary}")
