# SPDX-License-Identifier: Apache-2.0
"""What tests of the page do again and again."""

import re

from playwright.sync_api import expect

JUDGED = re.compile(r'\b(good|doubtful|bad)\b')


def judged(page, level):
    """Wait for the verdict and check its level."""
    expect(page.get_by_test_id('verdict')).to_have_class(JUDGED)
    expect(page.get_by_test_id('verdict')).to_have_class(re.compile(rf'\b{level}\b'))
    expect(page.get_by_test_id('step')).to_be_hidden()


def open_path(page, path):
    """Open a run by its path."""
    page.get_by_test_id('open').click()
    page.get_by_test_id('open-path').fill(str(path))
    page.get_by_test_id('open-go').click()
    expect(page.get_by_test_id('run')).to_have_value(path.name)


def choose_run(page, name):
    """Show another of the opened runs."""
    choose(page, 'run', name)


def choose(page, mark, name):
    """Choose what is offered by a field."""
    field = page.get_by_test_id(mark)
    if field.input_value() != name:
        field.click()
        page.get_by_role('option', name=name, exact=True).click()
        expect(field).to_have_value(name)
