"""Calibration files for tests, with the contents that lerobot-calibrate writes."""

#: Motors of an SO-101 in the order of their ids.
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def lerobot_calibration(slope, **changes):
    """Return the entries of LeRobot's calibration file of an SO-101, by joint.

    Args:
        slope: Difference of `range_max` from a servo to the next one [counts].
        **changes: Other values of some entries, by joint.
    """
    table = {
        joint: {
            "id": i,
            "drive_mode": 0,
            "homing_offset": 100 * i - 300,
            "range_min": 700 + 10 * i,
            "range_max": 3300 + slope * i,
        }
        for i, joint in enumerate(JOINTS, 1)
    }
    for joint, entry in changes.items():
        table[joint] |= entry
    return table
