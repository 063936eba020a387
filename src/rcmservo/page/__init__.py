"""The operator's page: live picture, controls, settings and past runs in a browser.

A new widget is one file in ``web/static/widgets``, a Vue component with its template, and one call
of `place_component` in ``web/layout.py``. That file builds with NiceGUI what stays the same while
the page is open: header, columns, cards, tabs, the chart and the 3-D scene. The files in
``web/static/drawings`` draw on the picture, the chart and the scene. No other code makes HTML,
neither strings in Python nor DOM calls.

The data of the widgets and drawings come from `view_model.Dashboard`. ``web/static/connection.js``
receives them over websockets of its own, for two reasons: a press counts only with the time at
which its state was displayed, and forty pictures a second must not wait behind NiceGUI's messages.
"""
