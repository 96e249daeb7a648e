"""
Folders of label, depth and pose files: 7-Scenes, ScanNet, TUM and the like.

In: patterns and options. Out: a recording.
Entered by commands.

"""
