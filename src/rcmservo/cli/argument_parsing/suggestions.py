"""Suggestions for an unknown command or option."""

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches

from rcmservo.config.former_names import present_name

MAX_SUGGESTIONS = 4
"""Largest number of suggested options."""
MIN_SIMILARITY = 0.65
"""Smallest similarity (0 to 1) of a suggested option."""


def format_suggestion(names: Iterable[str]) -> str:
    """Return the question that ends a message; empty without suggestions."""
    question = " or ".join(names)
    return f" (did you mean {question}?)" if question else ""


def suggest_options(word: str, known: Iterable[str]) -> str:
    """Return the question that suggests options for an unknown one.

    Users often type an option without its group, or with another group. The last part of a name is
    therefore compared by itself.
    """
    names = list(known)
    word = _replace_former_name(word, names)
    same = [name for name in names if _remove_group(name) == _remove_group(word)]
    groups = {_find_group(name): name for name in same}
    if same:
        near = get_close_matches(_find_group(word), list(groups), 1)
        return format_suggestion([groups[near[0]]] if near else same[:MAX_SUGGESTIONS])
    near = max(names, key=lambda name: _compute_similarity(word, name), default="")
    return format_suggestion([near] if _compute_similarity(word, near) >= MIN_SIMILARITY else [])


def _replace_former_name(word: str, names: list[str]) -> str:
    """Return an option with the present name of its setting, if it has a former one."""
    settings = {_remove_group(name).replace("-", "_") for name in names}
    present = present_name(_remove_group(word).replace("-", "_"), settings).replace("_", "-")
    return "--" + ".".join(filter(None, (_find_group(word), present))) if present else word


def _compute_similarity(word: str, name: str) -> float:
    """Return the similarity of two options, 0 to 1.

    For a word without a group the last part of the name counts as well.
    """
    whole = SequenceMatcher(None, word.lstrip("-"), name.lstrip("-")).ratio()
    without_group = SequenceMatcher(None, _remove_group(word), _remove_group(name)).ratio()
    return whole if "." in word else max(whole, without_group)


def _remove_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[2].replace("_", "-")


def _find_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[0]
