"""Suggestions for a misspelt option."""

from collections.abc import Iterable
from difflib import SequenceMatcher, get_close_matches

from rcmservo.config.former_names import find_present_name

MAX_SUGGESTIONS = 4
"""Largest number of suggested options."""
MIN_SIMILARITY = 0.65
"""Smallest similarity (0 to 1) of a suggested option."""


def suggest_options(word: str, known: Iterable[str]) -> str:
    """Return the question that suggests options for an unknown one; empty without a similar one.

    Users often type an option without its group, or with another group. The last part of a name is
    therefore compared by itself.
    """
    names = list(known)
    word = _replace_former_name(word, names)
    same = [name for name in names if _remove_group(name) == _remove_group(word)]
    if same:
        names_by_group = {_find_group(name): name for name in same}
        nearest_group = get_close_matches(_find_group(word), list(names_by_group), 1)
        suggestions = [names_by_group[group] for group in nearest_group] or same[:MAX_SUGGESTIONS]
    else:
        nearest = max(names, key=lambda name: _compute_similarity(word, name), default="")
        suggestions = [nearest] if _compute_similarity(word, nearest) >= MIN_SIMILARITY else []
    return f" (did you mean {' or '.join(suggestions)}?)" if suggestions else ""


def _replace_former_name(word: str, names: list[str]) -> str:
    """Return an option with the present name of its setting, if it has a former one."""
    settings = {_remove_group(name).replace("-", "_") for name in names}
    present = find_present_name(_remove_group(word).replace("-", "_"), settings).replace("_", "-")
    return "--" + ".".join(filter(None, (_find_group(word), present))) if present else word


def _compute_similarity(word: str, name: str) -> float:
    """Return the similarity of two options, 0 to 1.

    For a word without a group the last part of the name counts as well.
    """
    similarity = SequenceMatcher(None, word.lstrip("-"), name.lstrip("-")).ratio()
    if "." in word:
        return similarity
    return max(similarity, SequenceMatcher(None, _remove_group(word), _remove_group(name)).ratio())


def _remove_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[2].replace("_", "-")


def _find_group(name: str) -> str:
    return name.lstrip("-").rpartition(".")[0]
