# SPDX-License-Identifier: Apache-2.0
"""The card of a verdict in the studio, built without a browser."""

import asyncio
from concurrent.futures import ThreadPoolExecutor

from nicegui import Client
from nicegui.page import page

from rosette_ros.core.scheme import plan
from rosette_ros.simulation import Machine, MachineConfig
from rosette_ros.studio.controller import Controller
from rosette_ros.studio.panels import widgets
from rosette_ros.studio.panels.diagnosis_panel import VerdictPanel
from rosette_ros.studio.panels.figures_panel import FiguresPanel

DRIFT = {'kind': 'frame_drift', 'rate_um_per_h': [6.0, 0.0, 4.0]}


def test_the_card_and_both_models_are_shown(monkeypatch):
    """The parts of the card in their order, no shell command; curves and errors as modelled now and with the cause."""
    drawn = []
    monkeypatch.setattr(widgets.Figure, 'draw', lambda self, key, make, *arguments: drawn.append(arguments[0]))
    controller = Controller()
    run = Machine(MachineConfig().changed(seed=1, plate={'balls': 6}, hidden=[DRIFT])).run(plan(6, 'random', 1))
    controller.act(controller.session.open, run, 'run')
    with ThreadPoolExecutor(1) as threads:
        threads.submit(asyncio.run, controller.refresh()).result()
    with Client(page('/card')) as client:
        for panel in (VerdictPanel(controller, print, print, print, print), FiguresPanel(controller, print, print)):
            panel.show(controller.session.current)
    found = [element.text for element in client.elements.values() if getattr(element, 'text', '')]
    places = [found.index(words) for words in (
        'SYSTEMATIC EFFECT FOUND, NOT IN THE MODEL', 'probability', 'what moves, with what', 'likeliest law', 'size',
        'possible origin')]
    assert places == sorted(places)
    for begin in ('the probe moves by ', 'the probe moves with time', 'linear probe drift ('):
        assert any(words.startswith(begin) for words in found), begin
    assert not any('rosette ' in words for words in found)
    assert ['as modelled now', 'all explanations averaged'] in [
        [one.name for one in curves] for curves in drawn if isinstance(curves, list)]
    assert 'range, all explanations averaged' in found
