# SPDX-License-Identifier: Apache-2.0
"""The operator's settings file: what is refused, and in which words."""

import pytest
from scripted_server import SETTINGS

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.dme.dme_settings import dme_settings, load_dme_settings


@pytest.mark.parametrize(('changes', 'said'), [
    ({'schema': 'x'}, 'settings: wanted a mapping with "schema: rosette-dme/1"'),
    ({'path': {}}, 'settings: path.box_low_mm: wanted a value, got nothing'),
    ({'line\nfeed': 1}, 'settings: line feed: wanted one of ball, .*, schema, server, .*, got '),
    ({'sever': {}}, "settings: sever: wanted 'server', got 'sever'"),
    ({'server': {'port': 70000}}, 'settings: server.port: wanted less than 65536, got 70000'),
    ({'table': {'limits_deg': [0, 90]}}, 'limits_deg: wanted a whole turn between them, got'),
    ({'table': {'axis': [0, 0, 0]}}, 'wanted 3 numbers that are not all 0'),
    ({'table': {'sign': 2}}, 'settings: table.sign: wanted one of -1, 1, got 2'),
    ({'table': {'turn': 'spin'}}, 'settings: table.turn: wanted one of goto, align, none'),
    ({'tool': {'name': 'a"b'}}, 'wanted a text of printable ASCII without quotes'),
    ({'motion': {'approach_mm': 12.0}}, 'motion.approach_mm: wanted at most path.stand_off_mm = 10, got 12'),
    ({'ball': {'touches': 7}}, 'ball.touches: wanted one of 6, 8, 9'),
    ({'ball': {'below_pole_mm': 20.0}}, 'wanted circles on the ball'),
    ({'path': {**SETTINGS['path'], 'clearance_mm': 20.0}}, 'path.clearance_mm: wanted at least .*, 27.5, got 20'),
    ({'path': {'box_low_mm': [0, 0, 0], 'box_high_mm': [1, 0, 1]}}, 'box_low_mm below box_high_mm along y'),
])
def test_what_is_refused(changes, said):
    """One line with the key."""
    with pytest.raises(InvalidConfig, match=said):
        dme_settings({**SETTINGS, **changes})


def test_no_file():
    """In words."""
    with pytest.raises(InvalidConfig, match=r'/nowhere.yaml: wanted a settings file of an I\+\+ CMM that can be read'):
        load_dme_settings('/nowhere.yaml')
