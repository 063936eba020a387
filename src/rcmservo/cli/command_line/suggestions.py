"""Suggestions for a word that is no command or option."""

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches

from rcmservo.config.former_names import present_name

MOST = 4
"""Options that are suggested at most."""
NEAR = 0.65
"""Likeness from which on a word may be meant."""


def did_you_mean(names: Iterable[str]) -> str:
    """Return the question that ends a message; empty if nothing comes near."""
    question = " or ".join(names)
    return f" (did you mean {question}?)" if question else ""


def near_options(word: str, known: Iterable[str]) -> str:
    """Return the question for an option.

    An option in a group is often typed without its group, or with another one: so the last part of
    a name counts by itself.
    """
    names = list(known)
    word = _with_present_name(word, names)
    same = [name for name in names if _last(name) == _last(word)]
    groups = {_group(name): name for name in same}
    if same:
        near = get_close_matches(_group(word), list(groups), 1)
        return did_you_mean([groups[near[0]]] if near else same[:MOST])
    near = max(names, key=lambda name: _likeness(word, name), default="")
    return did_you_mean([near] if _likeness(word, near) >= NEAR else [])


def _with_present_name(word: str, names: list[str]) -> str:
    """Return an option with the present name of its setting, if it has a former one."""
    settings = {_last(name).replace("-", "_") for name in names}
    present = present_name(_last(word).replace("-", "_"), settings).replace("_", "-")
    return "--" + ".".join(filter(None, (_group(word), present))) if present else word


def _likeness(word: str, name: str) -> float:
    """Return how near two options are, from 0 to 1; of a word without a group the last part of the
    other counts too.
    """
    whole = SequenceMatcher(None, word.lstrip("-"), name.lstrip("-")).ratio()
    alone = SequenceMatcher(None, _last(word), _last(name)).ratio()
    return whole if "." in word else max(whole, alone)


def _last(name: str) -> str:
    return name.lstrip("-").rpartition(".")[2].replace("_", "-")


def _group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[0]
