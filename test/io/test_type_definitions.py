# SPDX-License-Identifier: Apache-2.0
"""Definitions of all installed types, checked by two parsers that are not ours.

rosbags computes the RIHS01 type hash from the text; mcap-ros2-support builds a decoder from it.
"""

import re

import pytest
from mcap_ros2._dynamic import generate_dynamic
from mcap_ros2._vendor.rosidl_adapter import parser
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from rosette_ros.core.run.errors import InvalidConfig
from rosette_ros.io.type_definitions import DELIMITER, TypeLibrary

PACKAGES = ('rosette_msgs', 'std_msgs', 'std_srvs', 'geometry_msgs', 'action_msgs', 'tf2_msgs',
            'diagnostic_msgs', 'rcl_interfaces', 'rosgraph_msgs')
"""Packages of which a cell may have topics."""


def installed(library):
    """Yield the types that topics may have, from the descriptions that are installed."""
    for prefix in library.prefixes:
        for path in sorted(prefix.glob('share/*/*/*.json')):
            package, kind, _ = path.parts[-3:]
            if package not in PACKAGES:
                continue
            if kind == 'msg':
                yield f'{package}/msg/{path.stem}'
            elif kind == 'srv':
                yield f'{package}/srv/{path.stem}_Event'
            elif kind == 'action':
                yield f'{package}/action/{path.stem}_FeedbackMessage'
                yield f'{package}/action/{path.stem}_SendGoal_Event'


def has_char(library, type_name):
    """Whether a type contains `char`: rosbags hashes it as a type of its own, ROS 2 as uint8."""
    return re.search(r'^char\b', library.definition(type_name).text, re.MULTILINE) is not None


def test_hash_of_every_type_is_what_rosbags_computes(library):
    """The text says everything that the hash covers: names, types, order, bounds."""
    names = list(installed(library))
    checked = 0
    for name in names:
        definition = library.definition(name)
        store = get_typestore(Stores.EMPTY)
        if definition.idl:
            for part in definition.idl.split(DELIMITER + '\n')[1:]:
                store.register(get_types_from_idl(part.split('\n', 1)[1]))
        elif has_char(library, name):
            continue
        else:
            store.register(get_types_from_msg(definition.text, name))
        assert store.hash_rihs01(name) == definition.hash, name
        checked += 1
    assert checked > 0.9 * len(names)
    assert {'rosette_msgs/msg/BallCentre', 'std_srvs/srv/Trigger_Event',
            'rosette_msgs/action/Calibrate_FeedbackMessage'} <= set(names)


def test_every_text_makes_a_decoder_in_mcap_ros2_support(library, monkeypatch):
    """Its check of names, which knows no service events, is widened; it knows no parts of actions at all."""
    monkeypatch.setattr(parser, 'VALID_MESSAGE_NAME_PATTERN', re.compile('[A-Z][A-Za-z0-9_]*$'))
    for name in installed(library):
        if '/action/' not in name:
            assert name in generate_dynamic(name, library.definition(name).text)


def test_every_schema_defines_a_type_once(library):
    """Foxglove (@foxglove/rosmsg) finds `Type` by the end of a full name and refuses a schema with two of that end."""
    for name in installed(library):
        definition = library.definition(name)
        headings = re.findall('^(?:MSG|IDL): (.*)$', definition.idl or definition.text, re.MULTILINE)
        ends = [heading.rpartition('/')[2] for heading in headings]
        for bare in re.findall(r'^[ \t]*([A-Z]\w*)(?:\[.*?\])? \w+$', definition.text, re.MULTILINE):
            assert ends.count(bare) <= 1, (name, bare)
        assert len(set(headings)) == len(headings), name


def test_event_has_its_true_layout(library):
    """Info, at most one request, at most one response, and an empty request has its byte."""
    text = library.definition('std_srvs/srv/Trigger_Event').text
    assert text.startswith('service_msgs/ServiceEventInfo info\n'
                           'Trigger_Request[<=1] request\nTrigger_Response[<=1] response\n')
    assert '\nMSG: std_srvs/Trigger_Request\nuint8 structure_needs_at_least_one_member\n' in text
    assert '=' * 80 + '\nMSG: builtin_interfaces/Time\n' in text


def test_bare_names_in_services_get_their_package(library):
    """`Diagnosis diagnosis` in a .srv means rosette_msgs/msg/Diagnosis wherever it is read."""
    text = library.definition('rosette_msgs/srv/Diagnose_Event').text
    assert re.search(r'^rosette_msgs/Diagnosis diagnosis', text, re.MULTILINE)


@pytest.mark.parametrize(('name', 'words'), [
    ('std_msgs/Header', 'message type: expected package/msg/Type.* found .std_msgs/Header.'),
    ('../msg/Header', 'message type: expected package/msg/Type'),
    ('no_such_msgs/msg/Thing', r'no_such_msgs/msg/Thing: expected its definition in '
     r'share/no_such_msgs/msg/Thing.json, not found below .*; install the package'),
])
def test_unknown_types_are_refused_with_words(library, name, words):
    """The error says what was looked for and where."""
    with pytest.raises(InvalidConfig, match=words):
        library.definition(name)


def test_damaged_description_is_refused_with_words(tmp_path):
    """A description that is no type description names its file."""
    folder = tmp_path / 'share' / 'some_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Thing.json').write_text('{"type_hashes": []}')
    with pytest.raises(InvalidConfig, match=r'Thing.json: expected a type description with '
                       r'type_description_msg and type_hashes, found something else'):
        TypeLibrary([tmp_path]).definition('some_msgs/msg/Thing')


def test_prefixes_come_from_the_environment():
    """AMENT_PREFIX_PATH lists them; without it the error says so."""
    assert [str(prefix) for prefix in TypeLibrary.from_environment(
        {'AMENT_PREFIX_PATH': '/a:/b'}).prefixes] == ['/a', '/b']
    with pytest.raises(InvalidConfig, match='AMENT_PREFIX_PATH is empty'):
        TypeLibrary.from_environment({}).definition('std_msgs/msg/Header')
