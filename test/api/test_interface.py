# SPDX-License-Identifier: Apache-2.0
"""The interface for Python: what it returns is what the command line prints, and it is loaded when it is used."""

import ast
import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest

import rosette_ros as rosette
from rosette_ros.api.documents import certificate_of
from rosette_ros.cli.main import main
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.core.run.records import CURVES

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}


def machine(balls=6, seed=3, hidden=(DRIFT,)):
    """Return a machine with a drift of the probe."""
    return {'seed': seed, 'plate': {'balls': balls}, 'table': {'translation_um': 0.5, 'rotation_urad': 3.0},
            'hidden': list(hidden)}


@pytest.fixture(scope='module')
def table(tmp_path_factory):
    """A table of a machine that hides a drift."""
    path = tmp_path_factory.mktemp('api') / 'hidden.csv'
    rosette.simulate(machine()).write(path)
    return path


@pytest.fixture(scope='module')
def found(table):
    """What is missing in the table."""
    return rosette.diagnose(table)


def printed(capsys, *words):
    """Return what the command prints."""
    capsys.readouterr()
    assert main(list(map(str, words))) == 0
    return capsys.readouterr().out


def same_json(capsys, path, model):
    """Check that interface and command line give the same text, with and without a model."""
    assert rosette.evaluate(path).json() + '\n' == printed(capsys, 'evaluate', path, '--json')
    assert rosette.evaluate(path, model, environment='workshop').json() + '\n' == printed(
        capsys, 'evaluate', path, '--model', model, '--environment', 'workshop', '--json')
    assert rosette.diagnose(path).json() + '\n' == printed(capsys, 'diagnose', path, '--json')
    assert rosette.compare(path, model, ladder=True).json() + '\n' == printed(
        capsys, 'compare', path, '--model', model, '--ladder', '--json')
    assert rosette.budget(path, environment='laboratory').json() + '\n' == printed(
        capsys, 'budget', path, '--environment', 'laboratory', '--json')


def test_json_is_that_of_the_command_line(table, tmp_path, capsys):
    """Byte for byte."""
    model = tmp_path / 'model.yaml'
    assert main(['add', 'frame_drift', '--model', str(model)]) == 0
    same_json(capsys, table, model)
    assert rosette.plan('row', balls=6, radius_mm=180).json() + '\n' == printed(
        capsys, 'plan', '--order', 'row', '--balls', '6', '--radius-mm', '180', '--json')
    assert rosette.plan('row', 'there_and_back:4', balls=6).json() + '\n' == printed(
        capsys, 'plan', 'row', 'there_and_back:4', '--balls', '6', '--radius-mm', '182.5', '--json')
    assert rosette.effects('frame_drift').json() + '\n' == printed(capsys, 'effects', 'frame_drift', '--json')
    assert rosette.advise(balls=6, order='row').json() + '\n' == printed(
        capsys, 'advise', '--balls', '6', '--order', 'row', '--json')


@pytest.mark.long
@pytest.mark.parametrize('seed', range(10))
def test_json_of_ten_runs(seed, tmp_path, capsys):
    """Of other plates, orders and hidden effects; plans of their orders, too."""
    balls, order = 5 + seed % 5, ('row', 'there_and_back', 'random', 'interleaved')[seed % 4]
    hidden = [{'seed': seed, 'most': 2}, [DRIFT], []][seed % 3]
    run = rosette.simulate({**machine(balls, seed), 'hidden': hidden}, order)
    run.write(path := tmp_path / 'run.csv')
    model = tmp_path / 'model.yaml'
    assert main(['add', 'table_zero_drift', '--model', str(model)]) == 0
    same_json(capsys, path, model)
    assert rosette.plan(order, balls=balls, seed=seed).json() + '\n' == printed(
        capsys, 'plan', '--order', order, '--balls', balls, '--radius-mm', '182.5', '--seed', seed, '--json')


def test_a_plan_says_which_radius_it_assumes(tmp_path, capsys):
    """Judged without one, never written: a CMM would drive to balls that are elsewhere."""
    made = rosette.plan('row', balls=6)
    assert 'on R = 182.5 mm (assumed)' in str(made)
    assert 'on R = 90 mm in' in str(rosette.plan('row', balls=6, radius_mm=90))
    with pytest.raises(rosette.InvalidPlan, match='row: expected radius_mm=, the radius of the circle of ball centres'):
        made.write(tmp_path / 'plan.csv')
    assert main(['plan', '--order', 'row', '--balls', '6', '-o', str(tmp_path / 'plan.csv')]) == 2
    assert 'row: expected --radius-mm, the radius' in capsys.readouterr().err
    rosette.plan('row', balls=6, radius_mm=90).write(tmp_path / 'plan.csv')
    both = rosette.plan('diagonal', tmp_path / 'plan.csv').plans
    assert [(one.scheme.n, round(1e3 * one.radius), one.is_stated) for one in both] == 2 * [(6, 90, True)]
    with pytest.raises(rosette.InvalidPlan, match='plan: expected balls= and radius_mm= with an order, or a plan file'):
        rosette.plan('row')


def test_next_readings_are_those_of_the_command_line(tmp_path, capsys):
    """Words, JSON and the plan; in the words of Python where a name is taken."""
    path = tmp_path / 'run.csv'
    rosette.simulate(machine(seed=5, hidden=()), 'diagonal').write(path)
    made = rosette.next_readings(path, number=4)
    assert made.json() + '\n' == printed(capsys, 'advise', path, '--readings', '4', '--json')
    assert rosette.advise(path).json() + '\n' == printed(capsys, 'advise', path, '--json')
    with pytest.raises(rosette.InvalidData, match='exists already; take another name or use force=True'):
        rosette.read(path).write(path)


def test_several_runs_are_evaluated_as_one(table, tmp_path, capsys):
    """The paths as they are given, the JSON byte for byte."""
    other = tmp_path / 'other.csv'
    rosette.simulate(machine(seed=4, hidden=()), 'row').write(other)
    made = rosette.evaluate([table, other])
    assert made.json() + '\n' == printed(capsys, 'evaluate', table, other, '--joint', '--json')
    frame = made.curves.to_frame()
    assert frame.shape == (6, 13)
    (first, _), *others = made.result.curves
    assert others and first.words in frame.attrs['title'] and 'clockwise' in first.words
    assert len(made.plot().axes) == 6


@pytest.mark.usefixtures('sketched')
def test_five_lines_from_a_table_to_curves(table, found, tmp_path):
    """What is hidden is found, the model has it, and the curves are the truth within U."""
    run = rosette.read(table)
    assert found.missing == ('frame_drift',) and found.level == 'bad'
    result = rosette.evaluate(run, found.model)
    frame, truth = result.curves.to_frame(), rosette.simulate(machine()).truth
    assert list(frame) == ['angle', *CURVES, *(f'U_{curve}' for curve in CURVES)]
    assert frame.attrs['units'] == {'angle': '°', **{f'{u}{c}': 'µm' if c[1] == 't' else 'µrad' for u in ('', 'U_')
                                                     for c in CURVES}}
    off = (frame[list(CURVES)].to_numpy() - 1e6 * truth.values) / frame[[f'U_{c}' for c in CURVES]].to_numpy()
    assert np.sqrt(np.mean(off**2)) < 1.0  # U is 2 u: 0.5 is expected
    page = rosette.report(run, found.model, tmp_path / 'report.html')
    assert page.read_text(encoding='utf-8').startswith('<!DOCTYPE html>')
    with pytest.raises(rosette.InvalidData, match='exists already'):
        rosette.report(run, found.model, page)


def test_a_result_is_shown_in_words_in_a_notebook_and_as_a_frame(table, found):
    """The sentence of the verdict, a card in its colour, tables whose note and units go with them."""
    sentence = json.loads(found.json())['verdict']
    assert str(found).startswith(sentence) and sentence in repr(found)
    card = found._repr_html_()
    assert '#c62828' in card and '<table>' in card
    assert 'frame_drift' in set(found.to_frame('candidates')['effect'])
    with pytest.raises(rosette.RosetteError, match="to_frame: expected one of .*, found 'no'"):
        found.to_frame('no')
    for result in (rosette.compare(table), rosette.ladder(table, found.model), rosette.budget(table),
                   rosette.correct(table, found.model), rosette.plan('row', balls=6), rosette.effects()):
        assert len(result.to_frame()) > 0 and '<table>' in result._repr_html_()
    for drawn in (found, rosette.evaluate(table), rosette.compare(table), rosette.plan('row', balls=6)):
        assert drawn.plot().axes
    assert 'probability' not in found.to_frame('explanations').attrs['units']  # a part of 1, not %
    assert len(str(rosette.effects()).splitlines()) == len(rosette.effects().names)


def test_a_card_of_readings_shows_them():
    """Its first rows, as people read numbers; words of a file are no markup."""
    run = rosette.simulate({'seed': 4, 'plate': {'balls': 8}}, run_id='<b>one')
    card = run._repr_html_()
    first = run.to_frame().iloc[0]
    assert f'<td>{first.x_mm:.5f}</td>'.replace('-', '−') in card and '<th>x / mm</th>' in card
    assert '<b>one' not in card and '&lt;b&gt;one' in card


def test_a_dataframe_with_other_names_is_read(table):
    """The same readings give the same run; NaN is an empty cell; what is missing is proposed."""
    run = rosette.read(table)
    own = run.to_frame().rename(columns={'table_position': 'Tisch', 'ball': 'Kugel', 'x_mm': 'X', 'y_mm': 'Y',
                                         'z_mm': 'Z', 'temperature_C': 'Temp'})
    own.loc[3, 'Temp'] = np.nan
    columns = {'table': 'Tisch', 'ball': 'Kugel', 'x': 'X', 'y': 'Y', 'z': 'Z', 'time': 'time_s', 'radius_mm': 182.5}
    again = rosette.read(own, columns).run
    assert np.array_equal(again.time, run.run.time) and np.allclose(again.centre, run.run.centre, rtol=0, atol=1e-15)
    same = rosette.read({name: own[name].tolist() for name in own}, columns).run
    assert same == again
    with pytest.raises(rosette.InvalidData, match=r"if these are ball centres: columns=\{'table': 'Tisch', .*radius"):
        rosette.read(own.drop(columns='table_angle_deg'))
    with pytest.raises(rosette.InvalidData, match='expected the column T of columns=, found Tisch,Kugel'):
        rosette.read(own, {**columns, 'table': 'T'})
    with pytest.raises(rosette.InvalidData, match=r"found a,b; if these are ball centres: columns=\{'table': '...'"):
        rosette.read({'a': [1], 'b': [2]})
    for wrong in (pandas.DataFrame([[1, 2]]), None, 3):
        with pytest.raises(rosette.InvalidData, match='expected a DataFrame, or columns by name, found'):
            rosette.read(wrong)


def test_a_correction_is_written(table, found, tmp_path):
    """As the command writes it."""
    assert rosette.correct(table, found.model).write(tmp_path / 'one.yaml') == tmp_path / 'one.yaml'
    (tmp_path / 'model.yaml').write_text('schema: rosette-model/1\neffects: [frame_drift]\n', encoding='utf-8')
    assert main(['correct', str(table), '--model', str(tmp_path / 'model.yaml'), '-o', str(tmp_path / 'two.yaml')]) == 0
    assert (tmp_path / 'one.yaml').read_text(encoding='utf-8') == (tmp_path / 'two.yaml').read_text(encoding='utf-8')


def test_importing_loads_nothing():
    """Not even numpy; errors and records load no plots and no files."""
    script = ('import sys, time; began = time.process_time(); import rosette_ros as rosette\n'
              'assert time.process_time() - began < 0.1 and "numpy" not in sys.modules\n'
              'rosette.InvalidData; rosette.Run\n'
              'assert not {"scipy", "matplotlib", "pandas", "yaml"} & sys.modules.keys()\n'
              'rosette.simulate({"plate": {"balls": 5}}, "row")\n'
              'assert not {"matplotlib.figure", "pandas"} & sys.modules.keys()\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_all_names_are_there_typed_and_documented():
    """Those that type checkers see are those that are loaded, and each is explained."""
    tree = ast.parse(Path(rosette.__file__).read_text(encoding='utf-8'))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name: node.module for node in block.body for alias in node.names}
    assert {name: f'rosette_ros.{module}' for name, module in rosette._PLACE.items()} == {
        name: module for name, module in typed.items() if name not in rosette._MODULES}
    for name in rosette.__all__:
        assert inspect.getdoc(getattr(rosette, name)), name
    assert 'evaluate' in dir(rosette)
    with pytest.raises(AttributeError, match='no attribute'):
        rosette.evaluated  # noqa: B018


def test_a_laboratory_adds_effects_and_readers_by_entry_points(tmp_path, table):
    """In a package of its own: every process has them, the command line too."""
    (tmp_path / 'lab.py').write_text(
        'from rosette_ros import PhysicalEffect, Quantity, courses, motions\n'
        'lift = PhysicalEffect("lab_lift", motions.TableAxial(), courses.Drift(), Quantity("d", "m/s", "rate"),\n'
        '                      plain="lift of the laboratory", meaning="The table rises.")\n'
        'def read(path):\n'
        '    rows = [line.split("|") for line in path.read_text().splitlines()]\n'
        '    names = dict(zip("table ball x y z".split(), rows[0]))\n'
        '    return dict(zip(rows[0], zip(*rows[1:]))), {**names, "radius_mm": 182.5}\n', encoding='utf-8')
    info = tmp_path / 'lab-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n', encoding='utf-8')
    (info / 'entry_points.txt').write_text('[rosette.effects]\nlift = lab:lift\n[rosette.readers]\nlab = lab:read\n',
                                           encoding='utf-8')
    run = rosette.read(table).to_frame()
    names = {'table_position': 'T', 'ball': 'B', 'x_mm': 'X', 'y_mm': 'Y', 'z_mm': 'Z'}
    run[list(names)].rename(columns=names).to_csv(tmp_path / 'run.lab', sep='|', index=False)
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(tmp_path), *sys.path])}
    script = ('from rosette_ros.cli.main import main\n'
              'print(*(main(words.split()) for words in ("effects lab_lift", "info run.lab", "evaluate run.lab")))\n')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, cwd=tmp_path, env=environment,
                          check=False)
    assert done.returncode == 0 and done.stdout.endswith('\n0 0 0\n'), done.stderr
    for wanted in ('The table rises.', '6 balls on R = 182.5 mm', '36 ball centres'):
        assert wanted in done.stdout


def test_own_effects_and_readers_of_this_process(table, monkeypatch):
    """A name that the library has is refused, and what is no effect."""
    with pytest.raises(rosette.InvalidModel, match='own effect: expected a PhysicalEffect, found str'):
        rosette.add_effect('frame_drift')
    twin = rosette.PhysicalEffect('frame_drift', rosette.motions.TableAxial(), rosette.courses.Drift(),
                                  rosette.Quantity('d', 'm/s', 'rate'), meaning='Another one.')
    with pytest.raises(rosette.InvalidModel, match='own effect frame_drift: expected another name'):
        rosette.add_effect(twin)
    rosette.add_reader('.Lab', lambda path: (pandas.read_csv(path, comment='#'), {'radius_mm': 182.5}))
    copy = table.with_suffix('.lab')
    copy.write_bytes(table.read_bytes())
    assert np.array_equal(rosette.read(copy).run.centre, rosette.read(table).run.centre)


@pytest.mark.usefixtures('sketched')
def test_the_report_is_that_of_the_command_line(table, tmp_path):
    """But for the line that repeats the command; of a table of another program, too."""
    own = pandas.read_csv(table, comment='#')[['table_position', 'ball', 'x_mm', 'y_mm', 'z_mm']]
    own.columns = ['Pos', 'Kugel', 'X', 'Y', 'Z']
    own.to_csv(foreign := tmp_path / 'own.csv', index=False)
    columns = {'table': 'Pos', 'ball': 'Kugel', 'x': 'X', 'y': 'Y', 'z': 'Z', 'radius_mm': 182.5}
    page = tmp_path / 'verb.html'
    words = ','.join(f'{key}={value}' for key, value in columns.items())
    assert main(['report', str(foreign), '--columns', words, '-o', str(page)]) == 0
    made = rosette.report(rosette.read(foreign, columns=columns), path=tmp_path / 'function.html')
    lines, others = (path.read_text(encoding='utf-8').splitlines() for path in (page, made))
    less = [line for line in lines if line not in others]
    assert len(less) <= 4 and any('rosette report' in line for line in less), less


def test_verbs_that_take_runs_take_columns(table, tmp_path, capsys):
    """A certificate states what the columns are, so that it is compared without; curves of two; a second run."""
    own = pandas.read_csv(table, comment='#')[['table_position', 'ball', 'x_mm', 'y_mm', 'z_mm']]
    own.columns = ['Pos', 'Kugel', 'X', 'Y', 'Z']
    own.to_csv(foreign := tmp_path / 'own.csv', index=False)
    columns = 'table=Pos,ball=Kugel,x=X,y=Y,z=Z,radius_mm=182.5'
    identity, xml = tmp_path / 'identity.yaml', tmp_path / 'cert.xml'
    identity.write_text('schema: rosette-identity/1\ncertificate: {number: "7"}\nlaboratory: {country: DE}\n'
                        'measured: {begin: 2026-04-12}\n')
    assert main(['certificate', str(foreign), '--columns', columns, '--identity', str(identity), '-o', str(xml)]) == 0
    assert main(['certificate', '--verify', str(xml), str(foreign)]) == 0, capsys.readouterr().err
    assert main(['certificate', '--verify', str(xml), str(foreign), '--columns', columns]) == 2
    made = rosette.certify(rosette.read(foreign, columns), tmp_path / 'other.xml', identity=identity)
    assert rosette.read(foreign, columns).columns and made.exists()
    with pytest.raises(InvalidData, match='expected the runs of one certificate with the same columns=, found others'):
        rosette.certify([rosette.read(foreign, columns), table], tmp_path / 'third.xml', identity=identity)
    capsys.readouterr()
    assert main(['compare-curves', str(foreign), str(foreign), '--columns', columns, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert max(abs(value) for one in found['curves'].values() for value in one['difference']) < 1e-9
    assert main(['report', str(foreign), '--overlay', str(foreign), '--columns', columns, '-o', str(tmp_path / 'o.html')
                 ]) == 0


def test_an_environment_goes_with_inputs_that_are_a_mapping(table, tmp_path):
    """As with those of a file: in the statement of a certificate, and of several runs as one."""
    identity = tmp_path / 'identity.yaml'
    identity.write_text('schema: rosette-identity/1\ncertificate: {number: "7"}\nlaboratory: {country: DE}\n'
                        'measured: {begin: 2026-04-12}\n')
    form = {'ball_form': {'form_um': 0.5}}
    (tmp_path / 'form.yaml').write_text('schema: rosette-budget/1\nball_form: {form_um: 0.5}\n')
    made = [certificate_of([table], identity=identity, inputs=inputs, environment='laboratory')
            for inputs in (form, tmp_path / 'form.yaml')]
    assert made[0].inputs.budget == made[1].inputs.budget
    assert dict(made[0].evaluation)['Environment'] == dict(made[1].evaluation)['Environment'] != 'none stated'
    assert [line.expanded for line in made[0].sets[0].lines] == [line.expanded for line in made[1].sets[0].lines]
    assert made[0].sets[0].lines[0].expanded > certificate_of(
        [table], identity=identity, inputs=form).sets[0].lines[0].expanded
    with pytest.raises(InvalidData, match='budget inputs: expected the section environment only with several runs'):
        rosette.evaluate([table, table], inputs=form)


def test_an_evaluation_is_a_workbook(table, tmp_path, capsys):
    """By the verb and the function; the first cell is the verdict."""
    openpyxl = pytest.importorskip('openpyxl')
    assert main(['evaluate', str(table), '--xlsx', str(tmp_path / 'verb.xlsx')]) == 0
    result = rosette.evaluate(table)
    result.save_workbook(tmp_path / 'function.xlsx')
    sheets = [openpyxl.load_workbook(tmp_path / f'{name}.xlsx') for name in ('verb', 'function')]
    for made in sheets:
        assert made['Result']['A1'].value == result.sentences()[0] and 'curves' in made.sheetnames
    assert main(['evaluate', str(table), '--xlsx', str(tmp_path / 'verb.xlsx')]) == 2
    assert 'exists already' in capsys.readouterr().err


def test_a_package_that_is_missing_is_named(monkeypatch, found):
    """pandas, where a DataFrame is asked for."""
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(rosette.PackageMissing, match='to_frame: expected the Python package pandas of the extra '
                       r'notebook, found none; pip install '
                       r'"rosette_ros\[notebook\]", or: pip install ipykernel pandas'):
        found.to_frame()
