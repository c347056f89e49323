# SPDX-License-Identifier: Apache-2.0
"""Files of budget inputs: what is read in SI units, what is refused in which words."""

from pathlib import Path

import pytest
import yaml

from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.uncertainty.budget_inputs import BOUNDS, ENVIRONMENT, SECTIONS
from rosette_ros.core.uncertainty.stated_environment import CLASSES, KINDS
from rosette_ros.io.budget_file import SCHEMA, budget_inputs, read_budget, read_stated


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
    sections = ('# touches', '# hidden', '# environment', '#   ')
    whole = yaml.safe_load('\n'.join(line[2:] if line.startswith(sections) else line
                                     for line in path.read_text().splitlines()))
    assert {*whole} == {'schema', BOUNDS, ENVIRONMENT, *SECTIONS}
    assert {*found.values} == {*SECTIONS} - {'touches'}
    assert budget_inputs(whole).bounds
    assert {*budget_inputs(whole).environment.sizes} == {*KINDS}


@pytest.mark.parametrize(('given', 'words'), [
    ({'ball_from': {}}, "b.yaml: expected one of touches, ball_form, .*, found 'ball_from'; did you mean 'ball_form'?"),
    ({'ball_form': {'form': 1}}, 'b.yaml: ball_form: expected one of form_um, touches, dof, words, found'),
    ({'ball_form': {'touches': 20}}, 'b.yaml: ball_form: expected form_um .*, found none'),
    ({'ball_form': {'form_um': -1}}, 'b.yaml: ball_form: form_um: expected a positive number, found -1'),
    ({'ball_form': {'form_um': '0.1 µm'}}, "expected a positive number, found '0.1 µm'"),
    ({'ball_form': {'form_um': True}}, 'expected a positive number, found True'),
    ({'ball_form': {'form_um': 1.0, 'touches': 7}}, 'touches: expected one of 6, 8, 9, 12, 16, 20, found 7'),
    ({'radius': {'u_um': 1.0, 'dof': 0.5}}, 'radius: dof: expected 1 or more degrees of freedom, found 0.5'),
    ({'radius': {'u_um': 1.0, 'words': 3}}, 'radius: words: expected a text of at most 300 characters, found 3'),
    ({'radius': 3}, 'b.yaml: radius: expected a mapping, found 3'),
    ({'hidden_effects': {'drift': 1.0}}, "b.yaml: hidden_effects: expected one of .*, found 'drift'"),
    ({'environment': {}}, r'b.yaml: environment: expected a class \(laboratory, workshop\) or some of .*found none'),
    ({'environment': {'class': 'hall'}}, "environment: class: expected one of laboratory, workshop, found 'hall'"),
    ({'environment': {'class': ['hall']}}, 'environment: class: expected one of laboratory, workshop, found'),
    ({'environment': {'drift': 1}}, "environment: expected one of class, machine, .*, found 'drift'"),
    ({'environment': {'machine': 0.3}}, "environment: machine: expected {um: 0.3, words: 'whence it is'}, found 0.3"),
    ({'environment': {'machine': {'um': 0.3}}}, 'environment: machine: words: expected a text of .*, found None'),
    ({'environment': {'machine': {'words': 'test'}}}, 'environment: machine: um: expected a positive number, found '
                                                      'None'),
    ({'environment': {'table_zero': {'um': 1}}}, "environment: table_zero: expected one of urad, words, found 'um'"),
    ({'environment': {'effects': {'drift': {}}}}, "environment: effects: expected one of .*, found 'drift'"),
    ({'environment': {'effects': 1}}, 'environment: effects: expected a mapping, found 1'),
    ({'schema': 'x'}, 'b.yaml: expected a mapping with "schema: rosette-budget/1"')])
def test_mistakes_are_named(given, words):
    """File, section, entry, what was wanted and what came."""
    with pytest.raises(InvalidData, match=words.replace('?', r'\?')):
        budget_inputs({'schema': SCHEMA, **given}, 'b.yaml')


def test_an_environment_is_a_class_or_numbers_or_both():
    """Numbers take the place of those of the class; each has its source; effects are by themselves."""
    lab = of(environment={'class': 'laboratory'}).environment
    assert lab.name == 'laboratory' and lab.sizes == CLASSES['laboratory'].sizes and not lab.effects
    both = of(environment={'class': 'workshop', 'machine': {'um': 0.8, 'words': 'ISO 230-3 of 2026-03-01'},
                           'effects': {'frame_cycle': {'um': 0.05, 'words': 'air conditioning'}}}).environment
    assert both.name == 'workshop, with numbers of the cell'
    assert both.sizes['machine'] == (pytest.approx(0.8e-6), 'ISO 230-3 of 2026-03-01')
    assert both.sizes['bearing'] == CLASSES['workshop'].sizes['bearing']
    assert both.effects['frame_cycle'].value == pytest.approx(0.05e-6)
    own = of(environment={'table_tilt': {'urad': 2, 'words': 'test'}}).environment
    assert own.name == 'stated' and {*own.sizes} == {'table_tilt'}
    assert of().environment is None and not of().is_stated and of(environment={'class': 'workshop'}).is_stated


def test_a_class_takes_the_place_of_that_of_a_file(tmp_path):
    """And stands alone where there is no file."""
    path = tmp_path / 'b.yaml'
    path.write_text(f'schema: {SCHEMA}\nradius: {{u_um: 1}}\nenvironment: {{class: workshop}}\n')
    assert read_budget(path).environment.name == 'workshop'
    assert read_stated(path, 'laboratory')['environment'] == {'class': 'laboratory'}
    assert 'radius' in read_stated(path, 'laboratory')
    assert read_stated(None, 'laboratory') == {'schema': SCHEMA, 'environment': {'class': 'laboratory'}}
    assert read_stated(None) is None
