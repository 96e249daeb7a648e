"""
A map file in a browser on this machine: one page, tiles as the camera needs them, answers.

In: a map file, also one that is being written. Out: HTTP on 127.0.0.1. Entered by
`persem map view`.

"""
