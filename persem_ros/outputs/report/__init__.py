"""
The page report.html: what a replay made of a recording, to be looked at.

In: frames while they pass, the map, metrics. Out: one HTML file.
Entered by replay and, for its looks, by view/ and evaluate.

"""
