# SPDX-License-Identifier: Apache-2.0
"""The pages for people: two of them, everything an engineer asks for, the XML attached."""

import io
import re
import unicodedata

import numpy as np
import pypdfium2
import pytest
from certificates import DAYS, FULL, KINDS, made
from PIL import Image
from pypdf import PdfReader

from rosette_ros.certificate.pages import to_pdf
from rosette_ros.certificate.statements import Inputs, state
from rosette_ros.core.run.errors import InvalidData
from rosette_ros.io.identity_file import parse_identity
from rosette_ros.presentation.tables import curves

pytestmark = pytest.mark.long


def pages_of(data):
    """Return the text of each page, white space as blanks."""
    return [' '.join(page.get_textpage().get_text_bounded().split()) for page in pypdfium2.PdfDocument(data)]


@pytest.mark.parametrize('kind', KINDS)
def test_the_xml_is_attached_to_the_pages(kind):
    """Byte by byte; each page says how many there are, two or three for a set of curves."""
    _, certificate, data = made(kind)
    pdf = to_pdf(certificate, data, 'cert.xml')
    assert dict(PdfReader(io.BytesIO(pdf)).attachments.items()) == {'cert.xml': [data]}
    pages = pages_of(pdf)
    assert len(certificate.sets) + 1 <= len(pages) <= len(certificate.sets) + 2
    for place, words in enumerate(pages, 1):
        assert f'page {place} of {len(pages)}' in words[:200] and 'Calibration certificate' in words[:200]
        assert 'SIMULATED: no real table was measured' in words


def test_an_engineer_finds_what_is_asked_for():
    """Identity, what was measured how, six numbers with U and verdicts, what is not known, where to sign."""
    _, certificate, data = made('clean')
    first, *others = pages_of(to_pdf(certificate, data, 'cert.xml'))
    second = ' '.join(others)
    for words in ('No. 2026-0413', 'issued 2026-11-30', 'Messlabor Süd, Ring 1, 80331, München, DE', 'order 4711',
                  'Room 3; 2026-04-12 to 2026-04-13', 'A. Messer', 'Tischbau RT 400 T-0815', '2026-K-113',
                  'Three-rosette method', '10.1016/j.measurement.2019.107366', 'Sequence ', 'Temperature 19.',
                  'The model fits', 'conforms', 'not decidable', 'Decision rule: ISO 14253-1',
                  'load on the table: plate, 18 kg; speed of the table: at rest',
                  'radial place of the measurement: on the circle of the ball centres, R = 182.5 mm',
                  'axial place of the measurement: 120 mm',
                  'Traceability CMM: 2026-K-113; thermometer: 2026-T-7', 'Clamped as in use & <'):
        assert words in first, words
    assert ' 1 nm ' in first and ' 0.3 arcsec ' in first, 'tolerances as stated'
    for line in certificate.sets[0].lines:
        assert f'{line.curve} ({line.name}) / {"µm" if line.curve[1] == "t" else "µrad"}' in first
    assert 'U: k = 2; residual' in first and 'of a point' not in first, 'a column that is not on the page'
    assert 'U, which does not contain thermal expansion and the scale of the CMM' in first
    for words in ('Limitations and conditions of validity', 'means of ctx, cty', 'SHA-256', certificate.files[0].sha256,
                  'rosette_ros 0.1.0', 'signature', 'B. Leiter, head of laboratory', 'table angle in degrees'):
        assert words in second, words


@pytest.mark.parametrize('kind', [*KINDS, 'no_fit'])
def test_no_page_has_a_few_lines_and_no_word_is_broken(kind):
    """The last page is filled to a fifth at least, or there is one page less; words of tables are whole."""
    _, certificate, data = made(kind)
    document = pypdfium2.PdfDocument(to_pdf(certificate, data, 'cert.xml'))
    for page in document:
        texts = page.get_textpage()
        bottom = min(texts.get_charbox(place)[1] for place in range(texts.count_chars()) if texts.get_charbox(
            place)[1] > 12 / 25.4 * 72)
        assert bottom < 0.8 * page.get_height()
    words = ' '.join(pages_of(to_pdf(certificate, data, 'cert.xml')))
    for whole in ('thermometer', 'tolerance', 'range', 'synchronous', 'fundamental'):
        assert whole in words or kind == 'bare'


def test_what_was_compensated_stands_on_the_pages():
    """With its size and U."""
    words = ' '.join(pages_of(to_pdf(*made('two_effects')[1:], 'cert.xml')))
    assert 'Compensated: effects that the curves do not contain' in words
    assert re.search(r'frame_drift d_x \S+ ±\S+ µm/h', words) and 'plate_warp a ' in words


def test_logo_and_mark_stand_at_the_top_of_the_first_page(tmp_path):
    """Where the identity names pictures beside its file; another file, or none, is refused by its name."""
    paths, _, data = made('clean')
    text = (FULL + DAYS).replace('email: kal', 'logo: logo.png, mark: mark.png, email: kal')
    certificate = state(paths, Inputs(parse_identity(text.encode()), '2026-11-30'))
    for name, colour in (('logo.png', (200, 0, 0)), ('mark.png', (0, 0, 200))):
        Image.new('RGB', (90, 30), colour).save(tmp_path / name)
    first, *others = pypdfium2.PdfDocument(to_pdf(certificate, data, 'cert.xml', tmp_path))
    seen = np.asarray(first.render(scale=1).to_pil())[:110].astype(int)
    for colour, side in ((0, slice(0, 200)), (2, slice(-200, None))):
        is_there = (seen[:, side, colour] > 150) & (seen[:, side, 1] < 60)
        assert is_there.sum() > 1000
    for page in others:
        assert np.ptp(np.asarray(page.render(scale=1).to_pil())[:60].astype(int), axis=2).max() < 200
    (tmp_path / 'mark.png').write_text('no picture')
    with pytest.raises(InvalidData, match='mark.png: expected a picture .PNG, JPEG., found something else'):
        to_pdf(certificate, data, 'cert.xml', tmp_path)
    (tmp_path / 'mark.png').unlink()
    with pytest.raises(InvalidData, match='mark.png: expected a picture that can be read, found No such file'):
        to_pdf(certificate, data, 'cert.xml', tmp_path)


def test_the_two_times_say_what_they_are_of():
    """The log lasts longer than the run: alignment and checks are in it."""
    first, *_ = pages_of(to_pdf(*made('simulated')[1:], 'cert.xml'))
    assert re.search(r'First and last reading 2026-11-22 [0-9:]{8} UTC to 2026-11-22 [0-9:]{8} UTC Duration \d+ min '
                     'from the first ball of the run to the last', first)


def test_the_budget_stands_on_the_pages():
    """Each contribution, what they make together, what is not considered, values per angle."""
    _, certificate, data = made('budget')
    pages = pages_of(to_pdf(certificate, data, 'cert.xml'))
    for one in certificate.budget.contributions:
        assert one.name in ' '.join(pages)
    assert 'Conformity is decided' not in pages[0] and 'nor the scale of the CMM' in ' '.join(pages)
    for row in curves(certificate.sets[0].motions).rows:
        assert ' '.join(row).replace('\n', ' ') in ' '.join(pages)
    for words in ('Uncertainty budget (GUM)', 'combined u', 'U (k = 2)', 'effective dof', 'Not considered:',
                  'Effects that this order of measurement hides', 'is that of the uncertainty budget', 'signature'):
        assert words in ' '.join(pages), words


def test_what_is_missing_stands_on_the_pages():
    """And in the place where it would stand."""
    pages = ' '.join(pages_of(to_pdf(*made('bare')[1:], 'cert.xml')))
    assert 'Missing mandatory data (ISO/IEC 17025, 7.8.2)' in pages and 'serial number of the rotary table' in pages
    assert pages.count('not stated') > 15 and 'name not stated, DE' in pages and 'signer not stated' in pages


def test_letters_of_every_script_are_set_or_refused_by_name():
    """None becomes a box, is set the wrong way round or without its marks."""
    paths, _, data = made('clean')

    def page(name):
        text = FULL.replace('Drehtisch AG', name).replace('tolerances', 'measured: {begin: 2026-04-12}\ntolerances')
        return pages_of(to_pdf(state(paths, Inputs(parse_identity(text.encode()), '2026-11-30')), data, 'cert.xml'))[0]
    for name in ('Čeněk Łódź ß', 'Αθήνα', 'Завод «Москва»', 'Công ty Việt', 'Tu\u0308v Ünal İş', 'Հայ', 'ქართული'):
        assert unicodedata.normalize('NFC', name) in page(name), name
    for name, script in (('株式会社 計量', 'cjk'), ('カメラ', 'katakana'), ('측정', 'hangul'), ('मापन', 'devanagari'),
                         ('قياس', 'arabic'), ('מדידה', 'hebrew'), ('วัด', 'thai'), ('A\u0336B', 'combining'),
                         ('📏', 'straight')):
        with pytest.raises(InvalidData, match='--pdf: expected letters that its font can set, found .* named '
                                              f'.*{script}'):
            page(name)


def test_long_entries_are_wrapped():
    """Two hundred letters without a blank stay within the margins."""
    paths, _, data = made('clean')
    long = parse_identity(FULL.replace('Room 3', 'R' * 200).replace('RT 400', 'M' * 200).replace(
        'tolerances', 'measured: {begin: 2026-04-12}\ntolerances').encode())
    document = pypdfium2.PdfDocument(to_pdf(state(paths, Inputs(long, '2026-11-30')), data, 'cert.xml'))
    for page in document:
        texts = page.get_textpage()
        assert max(texts.get_charbox(place)[2] for place in range(texts.count_chars())) < page.get_width() - 40
