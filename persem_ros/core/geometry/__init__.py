"""
The method geometry (spec section 12): what a place is depends on its shape.

In: a Snapshot of the memory and settings. Out: labels, sources, posteriors and the parameters that
were fitted. Enters memory/; entered by refine/, mosaic, preflight and outputs.

"""
