"""HTML reports: pages from templates, with embedded images, that open without a network."""

import base64

from jinja2 import Environment, PackageLoader, StrictUndefined


def render_template(package: str, **values: object) -> str:
    """Render the template ``report.html.j2`` of a package with some values."""
    environment = Environment(
        loader=PackageLoader(package, "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(**values)


def make_data_uri(kind: str, data: bytes) -> str:
    """Return the data URI of an image with the MIME type `kind`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
