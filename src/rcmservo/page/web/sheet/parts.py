"""What the parts of the page are made of: buttons and plain HTML."""

from nicegui import ui


def button(name: str, do: str, icon: str, words: str) -> None:
    """A button that says `do` to the server; `words` tell what it does."""
    made = ui.button(name, icon=icon).props("dense")
    made.props(f'aria-label="{name}" data-do="{do}"')
    made.on("click", js_handler=f"() => window.rcm.want('{do}')")
    made.tooltip(words)


def plain(html: str, classes: str = "") -> None:
    """HTML of our own, that static/*.js fills."""
    ui.html(html, sanitize=False).classes(classes)
