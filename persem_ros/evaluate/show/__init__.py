"""
Tables, figures and pages of an evaluation.

In: measures. Out: text, LaTeX, CSV, SVG, PNG, HTML.
Enters measure/; entered by run.py, sweep.py and compare.py.

"""
