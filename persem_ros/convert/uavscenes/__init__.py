"""
UAVScenes: its folders, its calibration, its LiDAR.

In: the root of the data set and the name of a run. Out: a recording.
Entered by commands; frames/ asks it what a UAVScenes folder looks like.

"""
