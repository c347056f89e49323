# SPDX-License-Identifier: Apache-2.0
"""Model files."""

import pytest

from rosette_ros.core.model.model import Model
from rosette_ros.core.run.errors import InvalidData, InvalidModel
from rosette_ros.io.model_file import format_model, read_model, write_model

MODELS = (
    Model(),
    Model(base=('plate_deviations', 'cmm_deviations')),
    Model().with_effect('frame_drift').with_effect('cmm_reversal'),
    Model().with_effect('frame_warmup', {'tau': 1800.0}),
)


@pytest.mark.parametrize('model', MODELS, ids=str)
def test_write_then_read_is_the_same_model(model, tmp_path):
    """Terms, fixed settings and hash."""
    path = tmp_path / 'model.yaml'
    write_model(model, path)
    assert read_model(path) == model
    assert read_model(path).hash == model.hash


def test_a_model_is_not_overwritten(tmp_path):
    """Unless forced, and then as a whole."""
    path = tmp_path / 'model.yaml'
    write_model(MODELS[0], path)
    with pytest.raises(InvalidData, match='exists already; take another name or use force=True'):
        write_model(MODELS[2], path)
    assert read_model(path) == MODELS[0]
    write_model(MODELS[2], path, force=True)
    assert read_model(path) == MODELS[2]
    assert [entry.name for entry in tmp_path.iterdir()] == ['model.yaml']


def test_what_is_left_out_has_its_default(tmp_path):
    """The base model whole, no effects."""
    (tmp_path / 'm.yaml').write_bytes(b'schema: rosette-model/1\n')
    assert read_model(tmp_path / 'm.yaml') == Model()


def test_the_written_text_is_what_a_person_would_write():
    """Schema first, lists below."""
    assert format_model(MODELS[2]).splitlines() == [
        'schema: rosette-model/1', 'base:', '- table_motions', '- plate_deviations',
        '- cmm_deviations', 'effects:', '- frame_drift', '- cmm_reversal']


@pytest.mark.parametrize(('data', 'words'), [
    (b'', 'm.yaml: expected a mapping with base and effects, found nothing'),
    (b'a: \xff', 'm.yaml: expected UTF-8 text, found byte 0xff at position 3'),
    (b'base: [x', 'm.yaml: expected YAML, found text that is none: line 2, column 1'),
    (b'base: []\nbase: []', "line 2, column 1: key 'base' stands twice"),
    (b'effects: [&a frame_drift, *a]', 'm.yaml: line 1: expected plain YAML, found an alias'),
    (b'effects: ' + b'[' * 5000, 'm.yaml: line 1: expected at most 20 levels of nesting'),
    (b'#' * 100_001, 'm.yaml: expected a model file of at most 100000 bytes'),
    (b'effects: [!!python/object:os.system {}]', 'm.yaml: expected YAML'),
    (b'effects: [2026-99-99]', 'm.yaml: expected YAML values, found one that is none'),
    (b'? [1]\n: 2', 'm.yaml: expected YAML, found text that is none: line 1, column 3'),
])
def test_what_is_no_model(tmp_path, data, words):
    """One line each; nothing is built from tricks."""
    (tmp_path / 'm.yaml').write_bytes(data)
    with pytest.raises(InvalidModel) as error:
        read_model(tmp_path / 'm.yaml')
    assert words in str(error.value)
    assert '\n' not in str(error.value)


def test_no_file(tmp_path):
    """Neither nothing nor a folder is a model file."""
    with pytest.raises(InvalidModel, match='expected a model file that can be read, found No such file or directory'):
        read_model(tmp_path / 'none.yaml')
    with pytest.raises(InvalidModel, match='expected a model file that can be read, found Is a directory'):
        read_model(tmp_path)
