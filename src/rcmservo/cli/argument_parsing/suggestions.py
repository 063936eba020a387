"""Suggestions for an unknown command or option."""

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches

from rcmservo.config.former_names import present_name

MAX_SUGGESTIONS = 4
"""Largest number of suggested options."""
MIN_SIMILARITY = 0.65
"""Smallest similarity (0 to 1) of a suggested option."""


def did_you_mean(names: Iterable[str]) -> str:
    """Return the question that ends a message; empty without suggestions."""
    question = " or ".join(names)
    return f" (did you mean {question}?)" if question else ""


def suggest_options(word: str, known: Iterable[str]) -> str:
    """Return the question that suggests options for an unknown one.

    Users often type an option without its group, or with another group. The last part of a name is
    therefore compared by itself.
    """
    names = list(known)
    word = _with_present_name(word, names)
    same = [name for name in names if _name_without_group(name) == _name_without_group(word)]
    groups = {_group(name): name for name in same}
    if same:
        near = get_close_matches(_group(word), list(groups), 1)
        return did_you_mean([groups[near[0]]] if near else same[:MAX_SUGGESTIONS])
    near = max(names, key=lambda name: _similarity(word, name), default="")
    return did_you_mean([near] if _similarity(word, near) >= MIN_SIMILARITY else [])


def _with_present_name(word: str, names: list[str]) -> str:
    """Return an option with the present name of its setting, if it has a former one."""
    settings = {_name_without_group(name).replace("-", "_") for name in names}
    present = present_name(_name_without_group(word).replace("-", "_"), settings).replace("_", "-")
    return "--" + ".".join(filter(None, (_group(word), present))) if present else word


def _similarity(word: str, name: str) -> float:
    """Return the similarity of two options, 0 to 1.

    For a word without a group the last part of the name counts as well.
    """
    whole = SequenceMatcher(None, word.lstrip("-"), name.lstrip("-")).ratio()
    without_group = SequenceMatcher(
        None, _name_without_group(word), _name_without_group(name)
    ).ratio()
    return whole if "." in word else max(whole, without_group)


def _name_without_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[2].replace("_", "-")


def _group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[0]
