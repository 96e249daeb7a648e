"""
Data sets on disk become recordings; one room a data set, over what they share here.

In: folders of images, poses, scans. Out: a rosbag2 recording of the usual topics.
Entered by commands, and by evaluate for reading label files.

"""
