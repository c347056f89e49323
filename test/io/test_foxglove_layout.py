# SPDX-License-Identifier: Apache-2.0
"""The layout for Foxglove names topics and fields that a log of a cell really has."""

import json
import re
from pathlib import Path

import pytest

LAYOUT = json.loads((Path(__file__).parents[2] / 'config' / 'foxglove_layout.json').read_text('utf-8'))
TYPES = {
    '/rosette/probe_target': 'rosette_msgs/msg/ProbeTarget',
    '/rosette/ball_centre': 'rosette_msgs/msg/BallCentre',
    '/rosette/error_motions': 'rosette_msgs/msg/ErrorMotions',
    '/rosette/run_state': 'rosette_msgs/msg/RunState',
    '/rosette/calibration_event': 'rosette_msgs/msg/CalibrationEvent',
    '/rosette/diagnosis': 'rosette_msgs/msg/Diagnosis', '/rosette/model': 'rosette_msgs/msg/Model',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray', '/rosout': 'rcl_interfaces/msg/Log'}


def paths(config):
    """Yield every message path of the panels."""
    for panel in config.values():
        yield from (entry['value'] for entry in panel.get('paths', ()))
        for key in ('topicPath', 'topicToRender'):
            if key in panel:
                yield panel[key]
        if 'xAxisPath' in panel:
            yield panel['xAxisPath']['value']


def panels(layout):
    """Yield the panels that a mosaic shows, those of tabs included."""
    if isinstance(layout, dict):
        yield from panels(layout['first'])
        yield from panels(layout['second'])
        return
    yield layout
    for tab in LAYOUT['configById'][layout].get('tabs', ()):
        yield from panels(tab['layout'])


@pytest.mark.parametrize('path', sorted(set(paths(LAYOUT['configById']))))
def test_every_path_leads_to_a_field(path, store):
    """Topic, field, field of a field, [:] where there are many."""
    topic, *fields = path.split('.')
    kind = TYPES[topic]
    for name in fields:
        wanted, many = re.fullmatch(r'(\w+)(\[:\])?', name).groups()
        entries = dict(store.fielddefs[kind][1])
        assert wanted in entries, f'{kind} has no {wanted}'
        node = entries[wanted]
        assert (int(node[0]) in (3, 4)) == bool(many), 'an array is asked for by [:]'
        kind = node[1] if isinstance(node[1], str) else node[1][0]


def test_every_panel_is_shown_once_and_configured():
    """A panel that is configured and not shown, or the other way round, is a slip."""
    shown = list(panels(LAYOUT['layout']))
    assert sorted(shown) == sorted(LAYOUT['configById'])
    assert all(entry.get('foxglovePanelTitle') for name, entry in LAYOUT['configById'].items()
               if not name.startswith('Tab!'))


def test_the_calibration_is_started_by_the_service_of_the_cell():
    """The name in the namespace that the launch file uses, an empty request."""
    panel = LAYOUT['configById']['CallService!start']
    assert panel['serviceName'] == '/rosette/start_calibration'
    assert json.loads(panel['requestPayload']) == {}
