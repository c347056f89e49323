# SPDX-License-Identifier: Apache-2.0
"""Whatever comes in at an interface: a value that makes sense or one clear error, nothing else.

`make fuzz` tries 10 000 inputs at each interface, `make test` some of them; what once caused a failure stays in
corpus/ and is tried always. Each input has a time limit, and what is accepted is held against a
second, independent reading of it.
"""

import csv
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import TREES, TRICKS, WORDS, bounded, corpus, dumped, mutated, tried

from rosette_ros.analysis import analyse
from rosette_ros.calibration.calibration_plan import plan_calibration
from rosette_ros.calibration.state_machine import Limits, Sequence
from rosette_ros.core.effects.custom import evaluate, names_in, parse
from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidModel, NotDeterminable, RosetteError
from rosette_ros.core.run.geometry import Frame
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import format_csv, parse_csv
from rosette_ros.io.messages import Answer, Phase, Target
from rosette_ros.io.model_file import parse_entry
from rosette_ros.io.plan_file import MeasuringPlan, format_plan, parse_plan
from rosette_ros.io.run_answers import RunAnswers
from rosette_ros.io.run_assembly import RunAssembly
from rosette_ros.io.safe_yaml import parse_yaml
from rosette_ros.simulation import Machine, MachineConfig, load_machine

pytestmark = pytest.mark.long

many = tried()

TABLE = format_csv(Machine(MachineConfig().changed(plate={'balls': 4})).run(plan(4, 'random'))).encode()


@st.composite
def cells_changed(draw):
    """Return the table with some cells, heads or head lines replaced by nasty words."""
    lines = TABLE.decode().splitlines()
    for _ in range(draw(st.integers(1, 3))):
        line = draw(st.integers(0, len(lines) - 1))
        cells = lines[line].split(',')
        cells[draw(st.integers(0, len(cells) - 1))] = draw(WORDS)
        lines[line] = ','.join(cells)
    order = draw(st.permutations(range(len(lines)))) if draw(st.integers(0, 9)) == 0 else range(len(lines))
    return '\n'.join(lines[k] for k in order).encode('utf-8', 'surrogatepass')


@bounded()
def check_table(data):
    """Accept or refuse a table; what is accepted says what a plain CSV reader reads in it."""
    try:
        run = parse_csv(data, 'fuzzed.csv')
    except RosetteError as error:
        assert 'fuzzed.csv' in str(error)
        assert '\n' not in str(error)
        return
    if run.notes:  # it was not as a plain reader takes it
        return
    text = data.decode('utf-8-sig')
    rows = list(
        csv.DictReader(
            io.StringIO(
                '\n'.join(
                    line for line in re.split('\r\n|\r|\n', text) if not line.lstrip().startswith('#') and line.strip()
                )
            ),
            skipinitialspace=True,
        )
    )
    assert run.size == len(rows)
    for axis, name in enumerate(('x_mm', 'y_mm', 'z_mm')):
        column = next(key for key in rows[0] if key.strip() == name)
        values = np.array([float(row[column]) for row in rows]) / 1e3
        assert np.array_equal(run.centre[:, axis], values)
    assert np.isfinite(run.centre).all()
    assert np.isfinite(run.time).all()
    assert 3 <= run.n <= 10_000
    if run.n <= 12 or 4 * run.size < run.n:
        try:
            fit = analyse(run)
        except NotDeterminable:
            return
        assert np.isfinite(fit.error_motions.values).all()


@many
@given(st.one_of(mutated(TABLE), cells_changed(), st.binary(max_size=400)))
def test_a_table(data):
    """CSV: bytes, cells, heads."""
    check_table(data)


@pytest.mark.parametrize('data', corpus('csv'))
def test_a_table_of_the_corpus(data):
    """What once caused a failure."""
    check_table(data)


def encoded(text):
    """Return a text as bytes."""
    return text.encode('utf-8', 'surrogatepass')


MODEL = b"""schema: rosette-model/1
base: [table_motions, plate_deviations, cmm_deviations]
effects:
  - frame_drift
  - {name: frame_warmup, tau: 600.0}
  - {own: mine, direction: axial, expression: t*cos(3*alpha), per: ball}
"""


def parse_model(data, source):
    """Return the model of a file's bytes."""
    return Model.from_mapping(parse_yaml(data, source, InvalidModel), source)


def test_what_is_mutated_is_sound_itself():
    """Else nothing that is accepted would ever be met."""
    assert parse_csv(TABLE, 'table').size == 16
    assert len(parse_model(MODEL, 'model').terms) == 3


@bounded()
def check_model(data):
    """Accept or refuse a model file; what is accepted comes back the same."""
    try:
        model = parse_model(data, 'fuzzed.yaml')
    except RosetteError as error:
        assert 'fuzzed.yaml' in str(error)
        assert '\n' not in str(error)
        return
    again = parse_model(dumped(model.to_mapping()), 'again')
    assert again.hash == model.hash


@many
@given(
    st.one_of(
        mutated(MODEL),
        TREES.map(dumped),
        st.builds(lambda effects: dumped({'schema': 'rosette-model/1', 'effects': effects}), TREES),
        st.builds('schema: rosette-model/1\neffects: [{{name: frame_warmup, tau: {}}}]'.format, TRICKS).map(encoded),
    )
)
def test_a_model(data):
    """YAML of models: text and trees."""
    check_model(data)


@pytest.mark.parametrize('data', corpus('model'))
def test_a_model_of_the_corpus(data):
    """What once caused a failure."""
    check_model(data)


PLANS = (format_plan(MeasuringPlan(plan(4, 'there_and_back'), 0.1)).encode(),
         b'schema: rosette-plan/1\nballs: 4\nradius_mm: 100\norder: there_and_back\ncmm_positions: [1, 2, 3]\n')


@many
@given(
    st.one_of(
        *map(mutated, PLANS),
        st.builds('schema: rosette-plan/1\nballs: {}\nradius_mm: {}\norder: row\n'.format, TRICKS, TRICKS).map(encoded),
        st.builds(lambda places: dumped({'schema': 'rosette-plan/1', 'balls': 4, 'radius_mm': 9.5, 'order': 'row',
                                         'cmm_positions': places}), TREES),
    )
)
@bounded()
def test_a_plan_file(data):
    """CSV and YAML: accept or refuse in one line; what is accepted is written and read again as it is."""
    try:
        made = parse_plan(data, 'fuzzed')
    except RosetteError as error:
        assert str(error).startswith('fuzzed: ') and '\n' not in str(error)
        return
    again = parse_plan(format_plan(made).encode(), 'again')
    for name in ('table_position', 'ball', 'approach', 'touches', 'session'):
        assert np.array_equal(getattr(again.scheme, name), getattr(made.scheme, name))


@many
@given(st.one_of(st.text(max_size=60), TRICKS, st.builds('tau: {}'.format, TRICKS),
                 TREES.map(lambda tree: dumped(tree).decode('utf-8', 'replace'))))
def test_an_entry_of_an_effect(text):
    """What add_effect takes as settings."""
    try:
        with bounded():
            entry = parse_entry(text, 'settings')
    except RosetteError as error:
        assert str(error).startswith('settings')
        return
    assert all(isinstance(key, str) for key in entry)


MACHINE = (Path(__file__).parents[2] / 'config' / 'machine.yaml').read_bytes()


@bounded()
def check_machine(data, path):
    """Accept or refuse a machine file; what is accepted measures a ball at a finite place."""
    path.write_bytes(data)
    try:
        config = load_machine(path)
    except RosetteError as error:
        assert path.name in str(error)
        assert '\n' not in str(error)
        return
    if config.plate.balls > 50:
        return
    try:
        machine = Machine(config)
        reading = machine.measure(1, 1)
    except RosetteError:
        return  # a machine that cannot reach its ball says so
    assert np.isfinite(reading.centre).all()
    assert math.isfinite(reading.time)


@many
@given(st.one_of(mutated(MACHINE), TREES.map(dumped), TRICKS.map(encoded),
                 st.builds('seed: {}'.format, TRICKS).map(encoded),
                 st.builds('plate:\n  balls:\n   {}'.format, TRICKS).map(encoded)))
def test_a_machine(tmp_path_factory, data):
    """YAML of the simulated machine: text and trees."""
    check_machine(data, tmp_path_factory.getbasetemp() / 'machine.yaml')


@pytest.mark.parametrize('data', corpus('machine'))
def test_a_machine_of_the_corpus(data, tmp_path):
    """What once caused a failure."""
    check_machine(data, tmp_path / 'machine.yaml')


TOKENS = st.lists(
    st.sampled_from(
        [
            't', 'T', 'phi', 'alpha', 'ψ', 'approach', 'pi', 'sin', 'cos', 'exp', 'sqrt', 'step', '(', ')', '+',
            '-', '*', '/', '**', '^', '1', '2.5', '1e9', '.', '__class__', '[', ']', 'lambda', ':', 'x', ',', '"a"',
            '0j', 'if', 'else', '==', '%', '//', '9**9', '\n', '#', ' ', 'import os', '@', '1_000', '{}', 'f""',
        ]
    ),
    max_size=24,
).map(''.join)


@many
@given(st.one_of(TOKENS, st.text(max_size=320)))
def test_an_expression(text):
    """An own term: arithmetic on known names or refused; never anything else runs."""
    try:
        with bounded():
            tree = parse(text)
    except RosetteError as error:
        assert str(error).startswith('expression')
        return
    known = {name: np.linspace(0.1, 1, 5) for name in names_in(tree)}
    with bounded(), np.errstate(all='ignore'):
        assert np.broadcast_to(np.asarray(evaluate(tree, known), dtype=float), 5).shape == (5,)


NUMBERS = st.one_of(st.floats(), st.floats(-1, 1), st.sampled_from([0.0, 1e-9, 1e300, -1e300]))
SMALL = st.integers(-3, 40)
ANSWERS = st.builds(
    Answer,
    run_id=st.sampled_from(['run', 'other', '']),
    seq=SMALL,
    table_position=SMALL,
    ball=SMALL,
    cmm_position=SMALL,
    status=st.integers(0, 2),
    text=st.text(max_size=5),
    table_angle=NUMBERS,
    table_travel=NUMBERS,
    approach=st.integers(-1, 1),
    centre=st.tuples(NUMBERS, NUMBERS, NUMBERS),
    form_error=NUMBERS,
    temperature=NUMBERS,
    frame_id=st.sampled_from(['machine', 'table', '', 'cell/table', 'x']),
    stamp_ns=st.integers(0, 2**62),
)


@many
@given(st.lists(st.one_of(ANSWERS, st.just('right')), max_size=30))
def test_answers_to_the_sequencer(answers):
    """Whatever the CMM says: only what was asked for counts, and the run goes on or ends in words."""
    planned = plan_calibration(plan(3, 'diagonal'), 0.1, Frame(np.eye(3), np.zeros(3)), repeats=2)
    sequence = Sequence('run', planned, Limits(attempts=2))
    sequence.begin(0.0)
    right = 0
    for now, answer in enumerate(answers):
        if answer == 'right' and not sequence.phase.is_end:
            target = planned.target(min(sequence.done, planned.total - 1))
            answer = Answer(
                'run',
                target.seq,
                target.table_position,
                target.ball,
                target.cmm_position,
                0,
                '',
                target.table_angle,
                0.0,
                1,
                target.centre,
                0.0,
                20.0,
                'table',
                0,
            )
        if answer == 'right':
            continue
        before = sequence.done
        with bounded():
            sequence.answer(answer, float(now))
        if sequence.done > before:
            right += 1
            assert answer.run_id == 'run'
            assert answer.status == 0
            assert np.isfinite(answer.centre).all()
    assert sequence.done == right
    if sequence.phase is Phase.FAILED:
        assert sequence.text


@many
@given(
    st.lists(
        st.tuples(
            SMALL,
            st.integers(0, 5),
            st.integers(0, 5),
            NUMBERS,
            st.tuples(NUMBERS, NUMBERS, NUMBERS),
            st.integers(0, 2),
        ),
        max_size=30,
    )
)
def test_answers_to_the_evaluator(rows):
    """Whatever is on the graph: a run is made of what counts, or refused in words."""
    run = RunAnswers('run')
    scheme = plan(3, 'row')
    for seq, (i, j) in enumerate(zip(scheme.table_position, scheme.ball, strict=True), 1):
        where = (0, 0.0, 0, (0.0, 0.0, 0.0), 'table')
        run.add_target(Target('run', seq, 1, 1, 3, 3, 0.1, int(i), int(j), *where, 1))
    for seq, i, j, angle, centre, status in rows:
        answer = Answer('run', seq, i, j, 0, status, '', angle, 0.0, 0, centre, 0.0, 20.0, 'table', 5)
        run.add_answer(answer)
    try:
        with bounded():
            run = RunAssembly(run, 'run').run()
    except RosetteError as error:
        assert 'run' in str(error)
        return
    assert np.isfinite(run.centre).all()
    assert np.isfinite(run.table_angle).all()
