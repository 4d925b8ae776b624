"""The Canadarm with IMUs at its links' ends in place of gauges, or beside some of them."""

from __future__ import annotations

import re

from data_files import CLAMPED_FREE_CANADARM

FILE = CLAMPED_FREE_CANADARM
ENDS = {'link_1': 6, 'link_2': 7}  # m
GYRO, ACCEL = 'gyro_noise="1e-4" gyro_bias="5e-3"', 'accel_noise="2e-3" accel_bias="0.05"'


def imu_text(gauges: str = '', of: str = f'{GYRO} {ACCEL}') -> str:
    """Return the description with IMUs and those gauges whose names have a text in them.

    `of` are noise and biases of the IMUs.
    """
    text = re.sub(
        r'<sensor name="(\w+)"[^>]*/>',
        lambda found: found[0] if gauges and gauges in found[1] else '',
        FILE.read_text(encoding='utf-8'),
    )
    imus = ''.join(
        f'<sensor name="{link}_imu" type="imu" link="{link}" station="{end}" {of}'
        f' topic="imu/{link}"/>'
        for link, end in ENDS.items()
    )
    return text.replace('</flexibility>', f'{imus}</flexibility>')
