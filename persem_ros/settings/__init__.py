"""
Settings and legends: every setting once, its YAML in ROS form, what class ids mean.

In: YAML files, words of the command line, ROS parameters. Out: a Config, a Legend, colours.
Everybody may enter; nothing in here knows messages or recordings, nor, but for the colours of a
legend, arrays.

"""
