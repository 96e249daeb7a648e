"""
libyaml in the place of ruamel's Python beneath rosbags: a quarter of the time of replays' tests.

rosbags writes and reads metadata.yaml and QoS profiles by ruamel.yaml, which without its own C
takes 50 ms of a small recording. outputs/test_recording_writer holds one against the other;
commands that tests start as processes have ruamel.

"""

from rosbags.rosbag2 import metadata, reader, writer
import yaml

MODULES = metadata, reader, writer
RUAMEL = metadata.YAML
PARSER, DUMPER = (getattr(yaml, f'CSafe{what}', getattr(yaml, f'Safe{what}'))
                  for what in ('Loader', 'Dumper'))


class Yaml:
    """What rosbags asks of ruamel's YAML."""

    def __init__(self, typ):
        assert typ == 'safe'
        self.default_flow_style = None

    def dump(self, data, stream):
        """Write *data* to a stream."""
        yaml.dump(data, stream, DUMPER, default_flow_style=self.default_flow_style)

    @staticmethod
    def load(text):
        """Return the content of a text, or of the file at a path."""
        return yaml.load(text if isinstance(text, str) else text.read_text('utf8'), PARSER)


def use(kind):
    """Have rosbags use *kind*, Yaml or RUAMEL, from now on."""
    for module in MODULES:
        assert hasattr(module, 'YAML')
        module.YAML = kind
