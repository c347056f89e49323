# SPDX-License-Identifier: Apache-2.0
"""The recorder beside two publishers of 2000 messages a second each, in short; in long: benchmarks/recorder_rate.py."""

from benchmarks.recorder_rate import measure


def main():
    """Print what is lost and what the recorder takes."""
    print(f'wanted: 2 x 2000 messages/s, none lost\n  {measure(2000.0, 10.0)}')


if __name__ == '__main__':
    main()
