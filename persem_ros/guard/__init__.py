"""
What stands between files from anywhere and the parsers that would trust them.

In: databases, YAML, packed bytes, names, as files hold them. Out: the same within bounds, or a
refusal that names the bound. Everybody may enter; nothing in here knows arrays or recordings.

"""
