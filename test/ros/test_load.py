"""More than it can map: images stay young, the map goes out, it says so; and nothing at all."""

import time
from types import SimpleNamespace

from camera import Camera
from harness import LATCHED, until
from persem_ros.inputs.live import BEHIND
from persem_ros.ros.inbox import Inbox, Item
from persem_ros.settings.config import Sync
from sensor_msgs.msg import Image, PointCloud2

LIVE = {'sync.max_wait': 1.0, 'sync.queue': 2.0, 'qos.queue': 20}


def test_under_overload_the_map_goes_out_and_images_stay_young(ros):
    mapper = ros.mapper({**LIVE, 'memory.voxel_size': 0.002, 'map.rate': 1.0}).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    images = ros.client.listen(Image, '/mapper/labels')
    camera = Camera(ros.client, size=(640, 480))
    camera.fly(100, hz=60.0, until=lambda: f'dropped: {BEHIND}' in mapper.values()
               and len(clouds) >= 3 and len(images) >= 3)
    mapper.says('-p memory.stride:=2')
    assert f'dropped: {BEHIND}' in mapper.values() and len(clouds) >= 3 and len(images) >= 3


def test_the_inbox_goes_on_with_the_newest_label_image():
    class Topic(SimpleNamespace):
        is_image = True
        __hash__ = object.__hash__

        def stamp_of(self, data):
            return int(data)

    box = Inbox(Sync(), lambda item: None)
    labels, depth = Topic(role='labels'), Topic(role='depth')
    for stamp in (100, 200, 300):
        box.put(Item(0, depth, 'Image', str(stamp - 5).encode()))
        box.put(Item(0, labels, 'Image', str(stamp - 50).encode()))
    box.put(Item(0, depth, 'Image', b'395'))
    assert box.skip(50, 20) == (300, 2)
    assert [box.get(0).data for _ in range(3)] == [b'295', b'250', b'395']
    assert box.bytes == 0 and box.skip(50, 20) is None


def test_nothing_arrives_and_nothing_is_published(ros):
    mapper = ros.mapper({**LIVE, 'map.rate': 10.0, 'refine.period': 0.1,
                         'refine.volatility_every': 2}).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    changes = ros.client.listen(PointCloud2, '/mapper/map_changes')
    camera = Camera(ros.client)
    camera.fly(60, until=lambda: int(mapper.values().get('frames', 0)) >= 10)
    refinements = settled(mapper)
    assert clouds and changes and all(cloud.width for cloud in changes)
    counts = len(clouds), len(changes)
    time.sleep(2.0)
    assert (len(clouds), len(changes)) == counts
    assert mapper.values()['refinements'] == refinements
    newcomer = ros.client.listen(PointCloud2, '/mapper/map')    # not latched, yet it gets the map
    until(lambda: newcomer and newcomer[-1].width == clouds[-1].width, 'the map for a newcomer')
    done, _ = mapper.call('refine')
    assert done


def settled(mapper):
    """Wait until nothing is refined any more; return the number of refinements."""
    def still():
        before = mapper.values()['refinements']
        time.sleep(2.5)
        return mapper.values()['refinements'] == before and [before]
    return until(still, mapper.values)[0]
