"""The operator's page: a client of `live`, as any other.

NiceGUI builds what stays the same while the page is open: header, columns, cards, tabs, the chart
and the 3-D scene (``web/layout.py``). Whatever changes is a Vue component with its template in
``web/static/parts``, which NiceGUI registers and ``wire.js`` feeds over websockets of its own: a
press counts only with the moment at which its state was shown, and forty pictures a second wait
behind none of NiceGUI's messages. Nothing else makes HTML, neither strings in Python nor calls of
the DOM; the other modules of ``web/static`` draw on the picture, the chart and the scene.
"""
