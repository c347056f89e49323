# SPDX-License-Identifier: Apache-2.0
"""rosette effects, and the page that is made from the library."""

import json
import re
import runpy
from pathlib import Path

from rosette_ros.core.effects.library import EFFECTS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / 'docs' / 'effects.md'


def test_the_library_is_listed(rosette):
    """Every name with what it means, the base model first."""
    out = rosette('effects').out
    names = [line.split()[0] for line in out.splitlines() if re.match(r'[a-z]+(_[a-z]+)* ', line)]
    wanted = ['table_motions', 'plate_deviations', 'cmm_deviations', *EFFECTS]
    assert [name for name in names if name in wanted] == wanted
    assert 'At one moment one ball moved on the plate.' in out


def test_one_effect_is_explained(rosette):
    """Possible origin, the form, the parameters with their units, the source."""
    out = rosette('effects', 'frame_warmup').out
    for words in ('Possible origin', 'd (1 - exp(-t/tau))', 'ISO 230-3', 'tau', 'time constant',
                  'min', 'searched and refined', 'final displacement along x'):
        assert words in out
    assert 'The balls are not at their nominal positions' in rosette('effects', 'plate_deviations').out


def test_json(rosette):
    """The whole library or one effect, the same keys."""
    every = json.loads(rosette('effects', '--json').out)
    assert every['schema'] == 'rosette-effects/1'
    assert [one['effect'] for one in every['effects']][3:] == list(EFFECTS)
    one, = json.loads(rosette('effects', 'frame_cycle', '--json').out)['effects']
    assert one == next(entry for entry in every['effects'] if entry['effect'] == 'frame_cycle')
    assert one['searched'][1] == {'name': 'period', 'unit': 's', 'meaning': 'period',
                                  'kind': 'scale'}
    assert [part['unit'] for part in one['amplitudes']] == ['m'] * 6


def test_an_unknown_name_lists_the_known_ones(refused):
    """In one line."""
    assert "Unknown effect 'drift'. Did you mean " in refused('effects', 'drift')


def test_the_page_is_that_of_the_library():
    """docs/effects.md is what `make docs` writes, with a row for every effect."""
    written = PAGE.read_text(encoding='utf-8')
    assert written == runpy.run_path(str(ROOT / 'tools' / 'effects_page.py'))['page'](), 'run make docs'
    for name, effect in EFFECTS.items():
        row = re.findall(rf'^\| `{name}` \|.*$', written, re.MULTILINE)[0]  # a motion may have the name of a law
        assert effect.meaning in row
        assert effect.look in row
