"""Suggestions for a word that is no command or option."""

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches

MAX_SUGGESTIONS = 4
"""Options that are suggested at most."""
MIN_SIMILARITY = 0.65
"""Likeness from which on a word may be meant."""


def did_you_mean(names: Iterable[str]) -> str:
    """Return the question that ends a message; empty if nothing comes near."""
    question = " or ".join(names)
    return f" (did you mean {question}?)" if question else ""


def suggest_options(word: str, known: Iterable[str]) -> str:
    """Return the question for an option.

    An option in a group is often typed without its group, or with another one: so the last part of
    a name counts by itself.
    """
    names = list(known)
    same = [name for name in names if _name_without_group(name) == _name_without_group(word)]
    groups = {_group(name): name for name in same}
    if same:
        near = get_close_matches(_group(word), list(groups), 1)
        return did_you_mean([groups[near[0]]] if near else same[:MAX_SUGGESTIONS])
    near = max(names, key=lambda name: _similarity(word, name), default="")
    return did_you_mean([near] if _similarity(word, near) >= MIN_SIMILARITY else [])


def _similarity(word: str, name: str) -> float:
    """Return how near two options are, from 0 to 1; of a word without a group the last part of the
    other counts too.
    """
    whole = SequenceMatcher(None, word.lstrip("-"), name.lstrip("-")).ratio()
    alone = SequenceMatcher(None, _name_without_group(word), _name_without_group(name)).ratio()
    return whole if "." in word else max(whole, alone)


def _name_without_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[2].replace("_", "-")


def _group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[0]
