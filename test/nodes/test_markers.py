"""Markers of centre lines are written into bytes that were laid out once."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from segmented_robots import spatial_text
from visualization_msgs.msg import Marker, MarkerArray

import denoc_ros as dn
from denoc_ros.nodes.markers import WIDTH, CentreLines, LineMarkers

pytestmark = pytest.mark.ros


def test_the_bytes_are_the_lines_whatever_was_drawn_before() -> None:
    markers = LineMarkers('odom')
    random = np.random.default_rng(4)
    for text in ('config/robots/ssrms.urdf', spatial_text(3), 'config/robots/ssrms.urdf'):
        lines = CentreLines(dn.load_robot(text))
        for stamp_ns in (3_000_000_007, 5):
            drawn = lines.points(0.1 * random.normal(size=lines._robot.n))
            raw = markers.encode(drawn, stamp_ns)
            assert len(raw) % 4 == 0  # what arrives is what was sent
            message = deserialize_message(raw, MarkerArray)
            assert [marker.ns for marker in message.markers] == [link for link, _, _ in drawn]
            assert [marker.id for marker in message.markers] == list(range(len(drawn)))
            for marker, (_, flexible, points) in zip(message.markers, drawn, strict=True):
                stamp = marker.header.stamp
                assert 10**9 * stamp.sec + stamp.nanosec == stamp_ns
                assert marker.header.frame_id == 'odom'
                assert (marker.type, marker.action) == (Marker.LINE_STRIP, Marker.ADD)
                assert (marker.scale.x, marker.pose.orientation.w) == (WIDTH, 1.0)
                assert marker.color.r == pytest.approx(0.85 if flexible else 0.35)
                told = [[point.x, point.y, point.z] for point in marker.points]
                np.testing.assert_array_equal(told, points)
