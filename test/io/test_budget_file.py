# SPDX-License-Identifier: Apache-2.0
"""Files of budget inputs: what is read in SI units, what is refused in which words."""

from pathlib import Path

import pytest
import yaml

from rosette_ros.core.budget_inputs import BOUNDS, SECTIONS
from rosette_ros.core.errors import InvalidData
from rosette_ros.io.budget_file import SCHEMA, budget_inputs, read_budget


def of(**sections):
    """Return the BudgetInputs of sections."""
    return budget_inputs({'schema': SCHEMA, **sections}, 'b.yaml')


def test_values_are_si_and_missing_ones_stay_missing():
    """Micrometres become metres; a section without entries is not stated; defaults are those of its entries."""
    found = of(ball_form={'form_um': 0.13, 'words': 'grade 5', 'dof': 20}, radius=None,
               hidden_effects={'frame_drift': 0.3})
    assert found.value('ball_form', 'form_um') == pytest.approx(0.13e-6)
    assert found.value('ball_form', 'touches') == 20
    assert 'radius' not in found and found.value('radius', 'u_um') == 0
    assert found.words == {'ball_form': 'grade 5'} and found.dof == {'ball_form': 20}
    assert found.bounds == {'frame_drift': pytest.approx(0.3e-6)}


def test_the_example_is_read():
    """All of its sections exist, those that are commented out included."""
    path = Path(__file__).parents[2] / 'config' / 'budget.yaml'
    found = read_budget(path)
    whole = yaml.safe_load('\n'.join(line[2:] if line.startswith(('# touches', '# hidden', '#   ')) else line
                                     for line in path.read_text().splitlines()))
    assert {*whole} == {'schema', BOUNDS, *SECTIONS}
    assert {*found.values} == {*SECTIONS} - {'touches'}
    assert budget_inputs(whole).bounds


@pytest.mark.parametrize(('given', 'words'), [
    ({'ball_from': {}}, "b.yaml: wanted one of touches, ball_form, .*, got 'ball_from'; did you mean 'ball_form'?"),
    ({'ball_form': {'form': 1}}, 'b.yaml: ball_form: wanted one of form_um, touches, dof, words, got'),
    ({'ball_form': {'touches': 20}}, 'b.yaml: ball_form: wanted form_um .*, got none'),
    ({'ball_form': {'form_um': -1}}, 'b.yaml: ball_form: form_um: wanted a positive number, got -1'),
    ({'ball_form': {'form_um': '0.1 µm'}}, "wanted a positive number, got '0.1 µm'"),
    ({'ball_form': {'form_um': True}}, 'wanted a positive number, got True'),
    ({'ball_form': {'form_um': 1.0, 'touches': 7}}, 'touches: wanted one of 6, 8, 9, 12, 16, 20, got 7'),
    ({'radius': {'u_um': 1.0, 'dof': 0.5}}, 'radius: dof: wanted 1 or more degrees of freedom, got 0.5'),
    ({'radius': {'u_um': 1.0, 'words': 3}}, 'radius: words: wanted a text of at most 300 characters, got 3'),
    ({'radius': 3}, 'b.yaml: radius: wanted a mapping, got 3'),
    ({'hidden_effects': {'drift': 1.0}}, "b.yaml: hidden_effects: wanted one of .*, got 'drift'"),
    ({'schema': 'x'}, 'b.yaml: wanted a mapping with "schema: rosette-budget/1"')])
def test_mistakes_are_named(given, words):
    """File, section, entry, what was wanted and what came."""
    with pytest.raises(InvalidData, match=words.replace('?', r'\?')):
        budget_inputs({'schema': SCHEMA, **given}, 'b.yaml')
