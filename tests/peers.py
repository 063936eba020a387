"""Other people's programs that tests talk to: a test whose peer is not there is skipped, with the
command that installs it, and a table at the end says which peers ran.

Where RCMSERVO_PEERS is "all", as in CI, such a test fails instead.
"""

import os
from collections import Counter
from typing import Any

import pytest


def peer(name: str, installed: bool, command: str) -> pytest.MarkDecorator:
    """The mark of tests that need a peer, for one test or as a file's `pytestmark`: its name,
    whether it is installed, and the command that installs it.
    """
    return pytest.mark.peer(name=name, installed=installed, command=command)


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("peer"):
        item.user_properties.append(("peer", mark.kwargs["name"]))
        if not mark.kwargs["installed"]:
            _without("{name} is not installed: {command}".format(**mark.kwargs))


def _without(sentence: str) -> None:
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
        told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        terminalreporter.line(f"{name}: {told}")
