"""
Forest Inspection: AirSim flights and WildUAV mappings, labels as colours.

In: the root of the data set and the name of a sequence. Out: a recording.
Entered by commands.

"""
