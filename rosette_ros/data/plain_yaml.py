# SPDX-License-Identifier: Apache-2.0
"""YAML of strangers: no aliases, no deep nesting, and one kind of error whatever is wrong with it.

A few hundred bytes of aliases within aliases stand for more than fits into a memory, and nesting of some ten
thousand levels ends the whole process in the loader: both are refused before anything is built.
"""

import yaml

DEEPEST = 20
"""Collections nested deeper than this are refused."""
BAD_VALUE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What the constructors of the loader raise besides YAMLError, such as for `!!int ""` or 2001-13-45."""

_Loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class NotPlain(yaml.YAMLError):
    """YAML that is refused although it may be some."""


def load_plain(text):
    """Return what YAML text says; raise yaml.YAMLError where it is none, or not plain."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_Loader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):
                raise NotPlain('wanted plain YAML, got an alias (*name); write it out')
            if depth > DEEPEST:
                raise NotPlain(f'wanted at most {DEEPEST} levels of nesting, got more')
        return yaml.load(text, Loader=_Loader)
    except BAD_VALUE as error:
        raise NotPlain(f'wanted YAML values, got one that is none: {type(error).__name__}') from error
