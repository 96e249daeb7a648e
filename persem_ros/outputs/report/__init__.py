"""The page report.html: what a replay made of a recording, to be looked at."""
