"""Sentences of the command line in the words of ROS."""

import re

FLAG = re.compile(r'--set (["\']?)([\w.]+)=')


def as_ros(sentence: str) -> str:
    """
    Return a sentence with ROS's flags in place of the command line's.

    `--set memory.stride=2` becomes `-p memory.stride:=2`. What is shared with the command line
    speaks its language; this is the one door through which its sentences come to ROS.

    """
    return FLAG.sub(r'-p \1\2:=', sentence)
