"""Curves: the loop's last half minute. static/curves.js asks for the numbers and draws them."""

from nicegui import ui

from rcmservo.page.web.site import Site


def curves_tab(site: Site) -> None:
    """Room for the charts."""
    del site
    chart = ui.echart({"series": []}).classes("w-full rcm-curves")
    chart.props('role="img" aria-label="Curves of the last 30 seconds"')
    chart.style("height: 46rem")
    ui.add_body_html(f"<script>window.RCMSERVO.curves = {chart.id};</script>")
