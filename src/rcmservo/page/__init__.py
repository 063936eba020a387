"""The operator's page: live picture, controls, settings and past runs in a browser.

The page is a client of `live`, like any other. NiceGUI builds what stays the same while the page is
open: header, columns, cards, tabs, the chart and the 3-D scene (``web/layout.py``). Everything that
changes is a Vue component with its template in ``web/static/parts``. NiceGUI registers these
components; ``connection.js`` feeds them over websockets of its own, for two reasons: a press counts
only with the time at which its state was displayed, and forty pictures a second must not wait
behind NiceGUI's messages. No other code makes HTML, neither strings in Python nor DOM calls; the
other modules of ``web/static`` draw on the picture, the chart and the scene.
"""
