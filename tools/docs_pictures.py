# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of reports, plans and budgets in docs/ from simulated runs: python tools/docs_pictures.py

The first screen of the page is taken by a headless Chromium (--browser PATH).
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from rosette_ros.analysis import analyse, summarise
from rosette_ros.core.joint.readings import Plate
from rosette_ros.core.model.model import Model
from rosette_ros.core.planning.plan_comparison import outlook
from rosette_ros.core.run.records import remove_gauge
from rosette_ros.core.run.scheme import places_in_use, plan
from rosette_ros.core.run.sphere_refit import TouchedBalls, refit_spheres
from rosette_ros.core.sight.visibility import visibility
from rosette_ros.core.uncertainty.budget_monte_carlo import monte_carlo
from rosette_ros.core.uncertainty.uncertainty_budget import budget, touch_scatter
from rosette_ros.io.ball_centre_table import write_csv
from rosette_ros.io.budget_file import read_budget
from rosette_ros.io.text_file import write_text
from rosette_ros.presentation.budget_results import agreement_words
from rosette_ros.presentation.plots.comparison_plots import budget_bars
from rosette_ros.presentation.plots.plan_plots import pictures_of_plans
from rosette_ros.presentation.plots.result_plots import Series, six_curves
from rosette_ros.presentation.report import open_source, pictures_of, report_html
from rosette_ros.simulation import Machine, MachineConfig

IMAGES = Path(__file__).parents[1] / 'docs' / 'images'
BROWSER = Path('/usr/bin/chromium')
DPI = 110
HIDDEN = [{'kind': 'frame_drift', 'rate_um_per_h': [0.9, 0.0, 0.5]},
          {'kind': 'ball_slip', 'ball': 4, 'shift_um': [0.9, 0.5, 0.3], 'at_h': 1.1}]
FINE = {'fine_orders': (11, 13, 17), 'fine_share': 0.5, 'translation_um': 0.3, 'rotation_urad': 2.0}
MOVED = (0, 30, 60, 90, 130, *range(150, 360, 30))
SHOWN = ('curves', 'residual_maps')
COMPARED = ('diagonal', 'row', 'there_and_back', 'interleaved', 'diagonal:50%')
SCREEN = 'report-verdict.png'


def main():
    """Make all pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--browser', type=Path, default=BROWSER, help=f'Chromium (default {BROWSER})')
    options = parser.parse_args()
    IMAGES.mkdir(exist_ok=True)
    config = MachineConfig().changed(seed=4, hidden=HIDDEN)
    run = Machine(config).run(plan(12, 'random'), run_id='rosette_20261121_083000_random')
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / 'run.csv'
        write_csv(run, table)
        run, source = open_source(table)
        summary = summarise(run)
        pictures = pictures_of(summary)
        for name in SHOWN:
            keep(pictures[name], f'report-{name.replace("_", "-")}.png')
        page = Path(folder) / 'page.html'
        write_text(page, report_html(summary, source, 'rosette report run.csv', pictures=pictures))
        photograph(page, options.browser)
    keep(irregular_plate(), 'plans-irregular-plate.png')
    picture_plans()
    keep(bars(), 'budget.png')


def bars(trials=10_000):
    """Return the uncertainty budget of a simulated run with the inputs of config/budget.yaml, and print its check."""
    drift = {'kind': 'frame_drift', 'rate_um_per_h': [0.5, 0.3, -0.4]}
    run, alignment, readings = Machine(MachineConfig().changed(seed=3, hidden=[drift])).calibrate(plan(12, 'random'))
    fit, refit = analyse(run, Model().with_effect('frame_drift')), touches(alignment, readings)
    made = budget(fit, read_budget(IMAGES.parents[1] / 'config' / 'budget.yaml'), touch_scatter(refit),
                  visibility(run, fit.sigma))
    found = monte_carlo(made, trials)
    print(agreement_words(found))
    return budget_bars(made, found)


def touches(alignment, readings):
    """Return the spheres fitted to the touches of a simulated run."""
    count, each = readings.touch_time.shape
    return refit_spheres(TouchedBalls(
        np.arange(1, count + 1), readings.table_position, readings.ball, readings.table_angle, readings.centre,
        np.full(count, 2.5e-3), np.repeat(np.arange(count), each), readings.touch_point.reshape(-1, 3),
        readings.touch_normal.reshape(-1, 3), readings.touch_time.ravel(), alignment.frame.rotation))


def irregular_plate():
    """Return the figure of a fine table, measured with an irregular plate at 36 positions and as usual at 12."""
    config = MachineConfig().changed(table=FINE, plate={'balls': 36})
    fine, usual = Machine(config), Machine(config.changed(plate={'balls': 12}))
    places = Plate(np.deg2rad(MOVED), np.full(12, config.radius), np.zeros(12)).places(36)
    run, alignment, _ = fine.calibrate(plan(36, balls=places))
    return six_curves([Series('36 table positions, 12 balls, one of them 10° off', analyse(run).error_motions),
                       Series('12 table positions, 12 balls of equal pitch', analyse(
                           usual.run(plan(12))).error_motions)],
                      truth=remove_gauge(fine.table_truth(frame=alignment.frame)))


def picture_plans():
    """Make the pictures of plans."""
    plans = []
    for name in COMPARED:
        order, _, places = name.partition(':')
        plans.append(outlook(name, plan(12, order, cmm_positions=places_in_use(places, 12)), 0.1825))
    pictures = pictures_of_plans(plans)
    for name in ('shares', 'uncertainty'):
        keep(pictures[name], f'plans-{name}.png')


def keep(figure, name):
    """Write a figure as a small PNG."""
    figure.savefig(IMAGES / name, dpi=DPI, pil_kwargs={'optimize': True})
    print(f'docs/images/{name}: {(IMAGES / name).stat().st_size / 1e3:.0f} kB')


def photograph(page, browser):
    """Take the first screen of a page."""
    if not browser.is_file():
        print(f'{browser}: no browser there, so {SCREEN} stays as it is')
        return
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=str(browser), args=['--no-sandbox', '--disable-gpu'])
        tab = chromium.new_page(viewport={'width': 1080, 'height': 680}, color_scheme='light')
        tab.goto(page.as_uri())
        tab.screenshot(path=IMAGES / SCREEN)
        chromium.close()
    print(f'docs/images/{SCREEN}: {(IMAGES / SCREEN).stat().st_size / 1e3:.0f} kB')


if __name__ == '__main__':
    main()
