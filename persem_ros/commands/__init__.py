"""One file per sub-command of persem: add_parser(subparsers) and run(args)."""


def add_settings(parser):
    """Give an argparse parser the options --config and --set, for config_file.from_args."""
    parser.add_argument('--config', metavar='FILE',
                        help="settings as YAML in ROS form; 'persem config' prints one")
    parser.add_argument('--set', metavar='NAME=VALUE', action='append', default=[],
                        dest='set_items', help='one setting, for example memory.voxel_size=0.2; '
                                               'may be given again, wins over --config')
