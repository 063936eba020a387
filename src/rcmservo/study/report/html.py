"""HTML reports: pages from templates that open offline, with their images embedded."""

import base64

from jinja2 import Environment, PackageLoader, StrictUndefined


def rendered(package: str, **values: object) -> str:
    """Return the page that the template ``report.html.j2`` of a package makes of some values."""
    environment = Environment(
        loader=PackageLoader(package, "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(**values)


def embedded(kind: str, data: bytes) -> str:
    """Return an image of some MIME type as the address that a page embeds."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
