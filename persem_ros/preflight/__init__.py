"""
What looks at a recording or at a finished run and gives advice, before and after.

In: recordings, settings, what a run used and left. Out: sentences with what to type.
Entered by info, replay, evaluate and the node; writes nothing.

"""
