"""Labels and depth that miss each other: the distance and the setting are named."""

from camera import Camera
from harness import BEST_EFFORT, until
import pytest
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

LIVE = {'sync.max_wait': 1.0, 'sync.queue': 2.0}


def test_labels_that_come_late_name_sync_max_wait(ros):
    mapper = ros.mapper(LIVE).ready()
    Camera(ros.client).fly(60, delay=2.5, until=lambda: 'sync.max_wait:=' in mapper.output)
    mapper.says('s before it')
    assert mapper.values()['frames'] == '0'


def test_with_the_setting_that_it_names_late_labels_are_mapped(ros):
    mapper = ros.mapper({**LIVE, 'sync.max_wait': 4.0}).ready()
    Camera(ros.client).fly(60, delay=2.5,
                           until=lambda: int(mapper.values().get('frames', 0)) >= 10)
    assert mapper.values()['dropped'] == '0', mapper.output


def test_depth_that_comes_after_its_labels_is_late_and_not_lost(ros):
    mapper = ros.mapper(LIVE).ready()
    camera = Camera(ros.client)
    camera.fly(60, delay=-1.5, until=lambda: 'came after their labels were given up'
               in mapper.output)
    mapper.says('s later than its label image')
    mapper.says('-p sync.max_wait:=3 lets them wait')
    assert 'lost' not in mapper.output and 'rmem_max' not in mapper.output
    mapper.stop()
    mapper = ros.mapper({**LIVE, 'sync.max_wait': 3.0}).ready()
    until(lambda: ros.client.node.count_subscribers('/depth/image') == 1, 'nobody listens')
    camera.fly(60, delay=-1.5, until=lambda: int(mapper.values().get('frames', 0)) >= 10)
    assert mapper.values()['dropped'] == '0', mapper.output


def test_labels_stamped_when_the_network_was_done_name_the_distance(ros):
    mapper = ros.mapper(LIVE).ready()
    Camera(ros.client, labels_offset=0.04).fly(
        60, until=lambda: 'sync.tolerance:=' in mapper.output)
    mapper.says('-p sync.offset_labels:=-0.0')
    assert '40 ms earlier' in mapper.output


def test_depth_that_no_label_wants_is_no_loss(ros):
    mapper = ros.mapper(LIVE).ready()
    # Long enough for depth that waited for its time to be let go of, and for diagnostics.
    Camera(ros.client).fly(60, hz=30.0, labels_every=10, until=lambda: int(
        mapper.values().get('depth without labels', 0)) > 30)
    assert mapper.values()['dropped'] == '0', mapper.output
    assert 'dropped' not in mapper.output


def test_the_bound_of_bytes_is_named_where_depth_waits_for_labels(ros):
    mapper = ros.mapper({**LIVE, 'sync.max_wait': 30.0, 'sync.queue_bytes': 1 << 20}).ready()
    Camera(ros.client, size=(320, 240)).fly(
        60, delay=20.0, until=lambda: 'queue full' in mapper.output)
    mapper.says('-p sync.queue_bytes:=2097152')


@pytest.mark.parametrize('qos, expected', [(QoSProfile(depth=50), 'reliable'),
                                           (BEST_EFFORT, 'best_effort')])
def test_auto_takes_what_the_publishers_offer(ros, qos, expected):
    auto = {f'qos.{name}': 'auto' for name in ('labels', 'depth', 'camera_info', 'pose')}
    ros.mapper({**LIVE, **auto}).ready()
    Camera(ros.client, qos=qos)
    assert reliability(ros, '/depth/image') == expected
    assert reliability(ros, '/depth/camera_info') == 'reliable'


def test_auto_subscribes_anew_when_a_publisher_of_another_kind_joins(ros):
    mapper = ros.mapper({**LIVE, 'qos.labels': 'auto', 'qos.depth': 'auto'}).ready()
    camera = Camera(ros.client, qos=QoSProfile(depth=50))
    assert reliability(ros, '/depth/image') == 'reliable'
    other = ros.client.node.create_publisher(Image, '/depth/image', BEST_EFFORT)
    until(lambda: reliability(ros, '/depth/image') == 'best_effort', 'a new subscription')
    ros.client.node.destroy_publisher(other)
    until(lambda: reliability(ros, '/depth/image') == 'reliable', 'a new subscription')
    camera.fly(60, until=lambda: int(mapper.values().get('frames', 0)) >= 5)


def reliability(ros, topic):
    """Return how the node listens to a topic, once it does."""
    ends = until(lambda: [end for end in ros.client.node.get_subscriptions_info_by_topic(topic)
                          if end.node_name == 'mapper'], f'nobody listens to {topic}')
    return ends[0].qos_profile.reliability.name.lower()


def test_images_that_are_lost_name_the_reliability_and_the_buffer(ros):
    mapper = ros.mapper({**LIVE, 'qos.labels': 'reliable', 'qos.depth': 'best_effort',
                         'qos.queue': 1}).ready()
    # Full HD without a pause: far more than a receive buffer holds.
    camera = Camera(ros.client, size=(1920, 1440), qos=QoSProfile(depth=2))
    camera.fly(100, hz=60.0, until=lambda: 'qos.depth:=reliable' in mapper.output)
    mapper.says('net.core.rmem_max')
    mapper.says('lost on the way')
