# SPDX-License-Identifier: Apache-2.0
"""The recorder at the highest rate that two publishers keep, in short; the long form: benchmarks/recorder_rate.py."""

from benchmarks.recorder_rate import measure

SECONDS = 10.0


def main():
    """Print rate, losses and what the recorder takes."""
    print(f'the recorder at the highest rate of two publishers, {SECONDS:g} s (wanted: none lost)')
    measure(SECONDS, tell=print)


if __name__ == '__main__':
    main()
