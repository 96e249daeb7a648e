"""
persem_ros: persistent semantic memory for robots.

label images + depth + poses -> observe -> memory -> refine -> render -> stable labels and a map

"""

__version__ = '0.1.0'
