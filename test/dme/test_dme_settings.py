# SPDX-License-Identifier: Apache-2.0
"""The operator's settings file: what is refused, and in which words."""

import pytest
from scripted_server import SETTINGS

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.dme.dme_settings import dme_settings, load_dme_settings


@pytest.mark.parametrize(('changes', 'said'), [
    ({'schema': 'x'}, 'settings: expected a mapping with "schema: rosette-dme/1"'),
    ({'path': {}}, 'settings: path.box_low_mm: expected a value, found nothing'),
    ({'line\nfeed': 1}, 'settings: line feed: expected one of ball, .*, schema, server, .*, found '),
    ({'sever': {}}, "settings: sever: expected 'server', found 'sever'"),
    ({'server': {'port': 70000}}, 'settings: server.port: expected less than 65536, found 70000'),
    ({'table': {'limits_deg': [0, 90]}}, 'limits_deg: expected a whole turn between them, found'),
    ({'table': {'axis': [0, 0, 0]}}, 'expected 3 numbers that are not all 0'),
    ({'table': {'sign': 2}}, 'settings: table.sign: expected one of -1, 1, found 2'),
    ({'table': {'turn': 'spin'}}, 'settings: table.turn: expected one of goto, align, none'),
    ({'tool': {'name': 'a"b'}}, 'expected a text of printable ASCII without quotes'),
    ({'motion': {'approach_mm': 12.0}}, 'motion.approach_mm: expected at most path.stand_off_mm = 10, found 12'),
    ({'ball': {'touches': 7}}, 'ball.touches: expected one of 6, 8, 9'),
    ({'ball': {'below_pole_mm': 20.0}}, 'expected circles on the ball'),
    ({'path': {**SETTINGS['path'], 'clearance_mm': 20.0}}, 'path.clearance_mm: expected at least .*, 27.5, found 20'),
    ({'path': {'box_low_mm': [0, 0, 0], 'box_high_mm': [1, 0, 1]}}, 'box_low_mm below box_high_mm along y'),
])
def test_what_is_refused(changes, said):
    """One line with the key."""
    with pytest.raises(InvalidConfig, match=said):
        dme_settings({**SETTINGS, **changes})


def test_no_file():
    """In words."""
    with pytest.raises(InvalidConfig, match=r'/nowhere.yaml: expected a settings file of an I\+\+ CMM that can be '
                                            r'read'):
        load_dme_settings('/nowhere.yaml')
