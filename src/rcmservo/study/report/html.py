"""HTML reports: pages from templates, with embedded images, that open without a network."""

import base64

from jinja2 import Environment, PackageLoader, StrictUndefined


def render_template(package: str, **values: object) -> str:
    """Render ``report.html.j2`` from the folder of a package; `values` fill it."""
    environment = Environment(
        loader=PackageLoader(package, "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(**values)


def make_data_uri(mime_type: str, data: bytes) -> str:
    """Return the data URI of an image with a MIME type."""
    return f"data:{mime_type};base64,{base64.b64encode(data).decode()}"
