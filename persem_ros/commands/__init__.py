"""One file per sub-command of persem: add_parser(subparsers) and run(args)."""
