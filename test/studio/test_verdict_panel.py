# SPDX-License-Identifier: Apache-2.0
"""The card of a verdict in the studio, built without a browser."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from nicegui import Client
from nicegui.page import page

from rosette_ros.core.run.scheme import plan
from rosette_ros.io.plan_file import parse_plan
from rosette_ros.presentation.report import Source
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.diagnosis_panel import VerdictPanel
from rosette_ros.studio.panels.figures_panel import FiguresPanel
from rosette_ros.studio.panels.request_panels import WayPanel

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}


def judged(config, source=None):
    """Return a controller that shows a judged run of a machine, and what work(controller) does in a thread."""
    controller = Controller()
    run = Machine(MachineConfig().changed(seed=1, plate={'balls': 6}, **config)).run(plan(6, 'random', 1))
    controller.act(controller.session.open, run, 'run', source)

    def do(work):
        with ThreadPoolExecutor(1) as threads:
            return threads.submit(asyncio.run, work(controller)).result()

    do(Controller.refresh)
    return controller, do


def test_the_card_and_both_models_are_shown(monkeypatch):
    """The parts of the card in their order, no shell command; curves and errors of the result and as modelled."""
    drawn = []
    monkeypatch.setattr(widgets.Figure, 'draw', lambda self, key, make, *arguments: drawn.append(arguments[0]))
    controller, _ = judged({'hidden': [DRIFT]})
    with Client(page('/card')) as client:
        for panel in (VerdictPanel(controller, print, print, print, print), FiguresPanel(controller, print, print)):
            panel.show(controller.session.current)
    found = [element.text for element in client.elements.values() if getattr(element, 'text', '')]
    places = [found.index(words) for words in (
        'SYSTEMATIC EFFECT FOUND, NOT IN THE MODEL', 'probability', 'moving body, correlated with', 'likely laws',
        'size', 'possible origin')]
    assert places == sorted(places)
    for begin in ('the probe moves by ', 'the probe moves with time', 'linear probe drift ('):
        assert any(words.startswith(begin) for words in found), begin
    assert not any('rosette ' in words for words in found)
    assert ['all explanations averaged', 'as modelled'] in [
        [one.name for one in curves] for curves in drawn if isinstance(curves, list)]
    titles = [words for words in found if words.startswith('Error motions of the rotary table')]
    assert [words.rpartition(', ')[2] for words in titles] == ['all explanations averaged', 'as modelled']


def test_doubts_are_settled_by_a_plan():
    """Where explanations are left, a button that chooses the readings: a plan after those of the run, and its words; a
    run without doubt has none."""
    clear, _ = judged({})
    doubtful, do = judged({'hidden': [{**DRIFT, 'rate_um_per_h': [1.0, 0.0, 1.0]}]})
    text = do(Controller.settle)
    made = parse_plan(text.encode(), 'next.csv').scheme
    run = doubtful.session.current.run
    assert np.array_equal(made.ball[:run.size], run.ball) and run.size < made.ball.size <= run.size + 12
    with Client(page('/settle')) as client:
        for controller in (clear, doubtful):
            VerdictPanel(controller, print, print, print, print).show(controller.session.current)
    buttons = [one for one in client.elements.values() if one.props.get('data-testid') == 'verdict-settle']
    assert [one.visible for one in buttons] == [False, True]
    (words,) = [one.text for one in client.elements.values() if one.props.get('data-testid') == 'verdict-next'
                and one.text]
    assert words.startswith('Settling: ') and ' expected to separate ' in words


def test_the_way_of_a_run_that_was_measured_until_it_is_known():
    """On request: one figure; another run has no such card."""
    source = Source('run', (), until=0.95, asked=(30, 36))
    controller, do = judged({'hidden': [DRIFT]}, source)
    do(Controller.show_way)
    with Client(page('/way')) as client:
        panel = WayPanel(controller, print)
        panel.show(controller.session.current)
        shown = [one for one in client.elements.values() if one.props.get('data-testid') == 'way']
        assert shown[0].visible
        panel.show(replace(controller.session.current, logged=None))
        assert not shown[0].visible
    assert '<svg' in controller.answer('way')
