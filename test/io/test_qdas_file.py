# SPDX-License-Identifier: Apache-2.0
"""Results as K-fields: what is written is what the reader of foreign tables reads."""

import datetime

from rosette_ros.io.foreign import aqdef
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.io.qdas_file import Characteristic, format_dfq

IDENTITY = parse_identity(b'schema: rosette-identity/1\ntable: {serial: RT-7, maker: Maker}\noperator: N. N.\n')


def test_values_limits_and_their_time_are_k_fields():
    """ASCII, CR LF, one line for each field; a value without a limit has none."""
    text = format_dfq([Characteristic('ctz, range', 1.25, 2.0, 'um'), Characteristic('ctz, U of the range', -0.1, None,
                                                                                      'um')],
                      IDENTITY, 'run 1', datetime.datetime(2026, 4, 12, 8, 30), 'The model\nfits.')
    lines = text.split('\r\n')
    assert text.isascii() and lines[:2] == ['K0100 2', 'K1002 rotary table'] and 'K1021 Maker' in lines
    assert {'K2002/1 ctz, range', 'K2111/1 2', 'K2142/1 um', 'K0001/1 1.25', 'K0004/1 12.04.2026/08:30:00',
            'K0001/2 -0.1', 'K0009/2 The model fits.', 'K0014/1 RT-7', 'K0008/1 N. N.'} <= {*lines}
    assert not any(line.startswith('K2111/2') for line in lines)
    found = aqdef.read(text, 'results.dfq')
    cells = [line.split('\t')[1:3] for _, line in found.lines[1:]]
    assert cells == [['ctz, range', '1.25'], ['ctz, U of the range', '-0.1']]
