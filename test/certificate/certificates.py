# SPDX-License-Identifier: Apache-2.0
"""Certificates of runs of every kind, made once for all tests."""

import functools
import tempfile
from pathlib import Path

import numpy as np

from rosette_ros.certificate.dcc import to_xml
from rosette_ros.certificate.statements import Inputs, state
from rosette_ros.core.run.scheme import plan
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.budget_file import EXAMPLE, read_stated
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.simulation import Machine, MachineConfig

GOLDEN = Path(__file__).parents[1] / 'golden'
BUDGET = Path(__file__).parents[2] / 'config' / 'budget.yaml'
FULL = '''schema: rosette-identity/1
certificate: {number: "2026-0413", date: 2026-11-30, remarks: "Clamped as in use & <tested>."}
laboratory: {name: Messlabor Süd, street: Ring 1, postcode: "80331", city: München, country: DE,
             email: kal@example.org, accreditation: D-K-00000}
customer: {name: Drehtisch AG, city: Zürich, country: CH, order: "4711"}
place: {name: Room 3, at: laboratory}
conditions: {load: "plate, 18 kg", speed: "at rest", axial: "120 mm above the top"}
traceability: "CMM: 2026-K-113; thermometer: 2026-T-7"
operator: A. Messer
signer: {name: B. Leiter, role: head of laboratory}
table: {maker: Tischbau, model: RT 400, serial: "T-0815"}
cmm: {maker: Koordinat, model: CMM 9, serial: "C-77", calibration: "2026-K-113"}
probe: {maker: Taster, model: T5, serial: "P-3"}
plate: {maker: Kugel, model: KP 12, serial: "KP-1"}
thermometer: {maker: Thermo, model: Pt100, serial: "TH-9"}
tolerances: {EXC: 50 µm, EYC: 0.1 µm, EZC: 1 nm, EAC: 0.3 arcsec, ECC: 0.01 urad}
'''
DAYS = 'measured: {begin: 2026-04-12, end: 2026-04-13}\n'
BARE = 'schema: rosette-identity/1\ncertificate: {number: X1}\nlaboratory: {country: DE}\n'
HIDDEN = ({'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 5.0]},
          {'kind': 'plate_warp', 'rate_um_per_h': 6.0})
TWO = {'base': ['table_motions', 'plate_deviations', 'cmm_deviations'], 'effects': ['frame_drift', 'plate_warp']}
KINDS = ('clean', 'two_effects', 'incomplete', 'joint', 'simulated', 'without_temperatures', 'bare', 'budget')


FOLDER = tempfile.TemporaryDirectory()
"""Of tables; removed at the end of the process."""


def table(name, order='random', seed=2, n=6, change=lambda run: run, **hidden):
    """Return the path of a table of a simulated machine."""
    path = Path(FOLDER.name) / f'{name}.csv'
    if not path.exists():
        config = MachineConfig().changed(seed=seed, plate={'balls': n}, **hidden)
        write_csv(change(Machine(config).run(plan(n, order, seed), run_id=name)), path)
    return path


def own_budget():
    """Return the path of inputs of a budget with the numbers of config/budget.yaml and words of a cell."""
    path = Path(FOLDER.name) / 'budget.yaml'
    path.write_text(BUDGET.read_text(encoding='utf-8').replace(f'{EXAMPLE}: ', ''), encoding='utf-8')
    return path


@functools.cache
def made(kind):
    """Return the paths, the Certificate and the document (bytes) of a kind of run."""
    inputs, dated = Inputs(parse_identity(FULL.encode()), '2026-11-30'), parse_identity((FULL + DAYS).encode())
    if kind == 'simulated':
        paths = (GOLDEN / 'logs' / 'log_clean_n6_diagonal',)
    elif kind == 'two_effects':
        paths, inputs = (table('two', hidden=HIDDEN),), Inputs(dated, '2026-11-30', TWO)
    elif kind == 'incomplete':
        paths = (table('gaps', change=lambda run: run.take(slice(0, -3)), hidden=HIDDEN),)
        inputs = Inputs(dated, '2026-11-30')
    elif kind == 'joint':
        paths = table('first', 'diagonal', 1), table('second', 'there_and_back', 1)
        inputs = Inputs(dated, '2026-11-30', is_joint=True)
    elif kind == 'rounded':
        paths = (table(kind, change=lambda run: run.replace(centre=np.round(run.centre, 6), repeatability=1e-7)),)
        inputs = Inputs(dated, '2026-11-30')
    elif kind == 'no_fit':
        paths = tuple(table(f'strict_{order}', order, change=lambda run: run.replace(repeatability=3e-8))
                      for order in ('diagonal', 'there_and_back'))
        inputs = Inputs(dated, '2026-11-30', is_joint=True)
    elif kind in ('without_temperatures', 'zero_temperatures'):
        degrees = np.nan if kind == 'without_temperatures' else 0.0
        paths = (table(kind, change=lambda run: run.replace(temperature=np.full(run.size, degrees))),)
        inputs = Inputs(dated, '2026-11-30')
    elif kind == 'budget':
        paths = (table('two', hidden=HIDDEN),)
        inputs = Inputs(dated, '2026-11-30', budget=read_stated(own_budget()))
    else:
        text = FULL if kind == 'clean' else BARE
        paths, inputs = (table('clean'),), Inputs(parse_identity((text + DAYS).encode()), '2026-11-30')
    certificate = state(paths, inputs)
    return paths, certificate, to_xml(certificate)
