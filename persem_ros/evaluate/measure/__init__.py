"""
Counts, and what is made of them: accuracy, mIoU, flicker, intervals.

In: labels by pixel, region and frame. Out: numbers with their uncertainty.
Enters neither work/ nor show/; both enter here.

"""
