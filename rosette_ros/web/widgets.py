# SPDX-License-Identifier: Apache-2.0
"""The few widgets of which every panel is made, with their names for keyboard and screen reader."""

from nicegui import ui

from rosette_ros.story import BAD, DOUBTFUL, GOOD

LEVELS = {GOOD: ('check_circle', 'Good'), DOUBTFUL: ('help', 'Open'), BAD: ('error', 'Something is missing')}
"""Level of a verdict: icon and word; the colour comes from the style sheet."""


def button(words, action, icon=None, mark='', strong=False, hint=''):
    """Return a button; mark: its name for tests; strong: the one that is meant to be pressed next."""
    made = ui.button(words, on_click=action, icon=icon, color=None)
    made.props(f'no-caps dense {"unelevated" if strong else "flat"} padding="4px 10px"')
    made.classes('strong' if strong else 'plain')
    if hint:
        made.props(f'title="{hint}"')
    if not words:
        made.props(f'aria-label="{hint}"')
    return marked(made, mark)


def marked(element, mark):
    """Return the element with a name for tests."""
    if mark:
        element.props(f'data-testid={mark}')
    return element


def text(words='', style='', tag='div', mark=''):
    """Return an element with text."""
    made = ui.element(tag).classes(style)
    with made:
        inner = ui.label(words)
    inner.props.pop('class', None)
    return marked(inner, mark)


def card(heading='', mark=''):
    """Return a card with a heading."""
    made = ui.element('section').classes('card')
    if heading:
        made.props(f'aria-label="{heading}"')
        with made:
            ui.html(heading, sanitize=False, tag='h2')
    return marked(made, mark)


def set_words(label, words):
    """Change a label's text only where it differs."""
    if label.text != words:
        label.set_text(words)
