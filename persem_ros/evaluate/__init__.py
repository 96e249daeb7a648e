"""
The evaluation: recordings with truth become the paper's tables, figures and intervals.

Rooms: work/ (recordings to counts), measure/ (counts to numbers), show/ (numbers to pages).
Entered by commands; run.py, sweep.py and compare.py tell the three stories.

"""
