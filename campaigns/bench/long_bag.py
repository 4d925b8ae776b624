"""A long bag made on the spot and replayed.

`python -m campaigns long-bag`

An arm with two flexible links at 1 kHz beside a camera, 1 GB unless told; prints how long the
replay takes and the most memory that its process ever had.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from denoc_ros.bags.definitions import encode
from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import bag_contents
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import load_robot

ROBOT = Path(__file__).resolve().parents[2] / 'config/robots/canadarm.urdf'
BOUND = 500e6  # bytes that the replay's process may have
RATE, FRAMES = 1000, 30  # Hz
WIDTH, HEIGHT = 320, 240
IMAGE = 'sensor_msgs/msg/Image'
START_NS = 1_700_000_000_000_000_000
AMPLITUDE, PULSATION = (0.4, 0.3, 0.5), (0.5, 0.7, 1.1)


def write_bag(path: Path, size: float, camera: bool) -> None:
    """Write seconds of joint states, and images, until the file has a size [bytes]."""
    robot = load_robot(ROBOT, gravity=(0.0, 0.0, 0.0))
    encoder = JointStateMessage(robot.joint_names, FIELDS)
    pixels = np.random.default_rng(0).integers(0, 256, WIDTH * HEIGHT).astype(np.uint8)
    fields = {'height': HEIGHT, 'width': WIDTH, 'encoding': 'mono8', 'step': WIDTH, 'data': pixels}
    image = encode(IMAGE, 0, fields)
    with (
        BagWriter(path, compression='none') as bag,
        tqdm(total=size, unit='B', unit_scale=True, disable=None) as bar,
    ):
        bag.attach('robot_description.urdf', ROBOT.read_text(encoding='utf-8'))
        bag.add_topic('/joint_states', JOINT_STATE)
        bag.add_topic('/camera/image_raw', IMAGE)
        second = 0
        while (written := path.stat().st_size) < size:
            bar.update(written - bar.n)
            t = second + np.arange(RATE) / RATE
            angle = np.outer(t, PULSATION)
            q = AMPLITUDE * (1.0 - np.cos(angle))
            qd = AMPLITUDE * np.sin(angle) * PULSATION
            for k in range(RATE):
                stamp_ns = START_NS + round(t[k] * 1e9)
                bag.write('/joint_states', stamp_ns, encoder.encode(stamp_ns, q[k], qd[k], qd[k]))
                if camera and k * FRAMES % RATE < FRAMES:
                    bag.write('/camera/image_raw', stamp_ns, image)
            bag.flush()
            second += 1


def replay(path: Path, output: Path) -> dict[str, float]:
    """Replay in a process of its own; return seconds and its largest memory [bytes]."""
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'replay', str(path), '-o', str(output)]
    began = time.perf_counter()
    subprocess.run([*command, '--gravity', '0', '0', '0'], check=True, stdout=subprocess.DEVNULL)
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {'seconds': time.perf_counter() - began, 'memory': 1024.0 * usage.ru_maxrss}


def main() -> int:
    """Make, replay, judge; the bags go again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--size', type=float, default=1e9, help='of the bag [bytes]')
    parser.add_argument('--no-camera', action='store_true', help='joint states alone')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag, output = Path(folder, 'long.mcap'), Path(folder, 'replayed.mcap')
        write_bag(bag, args.size, not args.no_camera)
        result = {
            'size': bag.stat().st_size,
            'joint_states': bag_contents(bag).topics[0].messages,
            **replay(bag, output),
        }
        before, after = bag_contents(bag), bag_contents(output)
        computed = sum(t.messages for t in after.topics if t.name.startswith('/replay/'))
        assert after.messages - computed == before.messages
        assert computed == 4 * result['joint_states']
    print(json.dumps(result))
    return 0 if result['memory'] <= BOUND else 1


if __name__ == '__main__':
    sys.exit(main())
