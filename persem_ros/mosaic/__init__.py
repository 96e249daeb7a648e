"""
Many recordings become one map, on many cores: `persem build` (spec section 10).

In: recordings and settings. Out: the map that a replay of them one after the other leaves, bit
for bit. Recordings are observed side by side (observe.py), their histories joined tile by tile
(join.py, blocks.py), tiles refined side by side with the class volatility of all (refine.py) or by
parameters that were fitted to all (fit.py: a map, look.py and count.py, and a reduce a round), and
written as one map file (assemble.py); run.py tells the story, folder.py keeps what is finished.
Enters core, inputs, outputs; entered by the command.

"""
