# SPDX-License-Identifier: Apache-2.0
"""A certificate as a digital calibration certificate, DCC 3.3.0 with D-SI 2.2.1."""

import copy
import hashlib
import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from lxml import etree
from lxml.builder import ElementMaker

from rosette_ros.certificate.statements import (
    COMPENSATED,
    DOI,
    METHOD,
    PAPER,
    Certificate,
    CurveSet,
    Inputs,
    Measured,
    release,
)
from rosette_ros.core.model.least_squares import Parameter
from rosette_ros.core.run.records import CURVES, SI_UNITS, Floats
from rosette_ros.core.uncertainty.budget_lines import Contribution
from rosette_ros.core.uncertainty.coverage import COVERAGE_FACTOR
from rosette_ros.core.uncertainty.error_summary import DECISION_RULE, AxisError, Conformity
from rosette_ros.core.uncertainty.uncertainty_budget import Budget
from rosette_ros.io.identity_file import DEVICES, Identity
from rosette_ros.presentation import formatting as text
from rosette_ros.presentation.budget_results import NOTE
from rosette_ros.presentation.error_results import conformity_words
from rosette_ros.presentation.identity_words import NOT_STATED, SIMULATED
from rosette_ros.words.budget_words import not_considered
from rosette_ros.words.effect_words import setting_words, words_of

DCC, SI, OWN = 'https://ptb.de/dcc', 'https://ptb.de/si', 'urn:rosette:certificate:1'
SCHEMA = '3.3.0'
MICRO = {'m': r'\micro\metre', 'rad': r'\micro\radian'}
UNITS = {'m': r'\metre', 'rad': r'\radian', 'K': r'\kelvin', '1/K': r'\kelvin\tothe{-1}',
         'm/K': r'\metre\kelvin\tothe{-1}'}
"""Units of inputs of the budget."""
BASE = {'m': r'\metre', 'rad': r'\radian', 's': r'\second', 'K': r'\kelvin'}
"""Of the parameters of effects."""
NEARLY_NORMAL = 0.945
"""Probability of U from which on its distribution is stated as normal: 29 degrees of freedom and more."""
STATUS = {Conformity.CONFORMS: 'pass', Conformity.FAILS: 'fail'}
CANONICAL = 'C14N 2.0'
"""How the digest of the content is made, as a document states it; those of version 0.1 do not."""
HINTS = [f'{{http://www.w3.org/2001/XMLSchema-instance}}{name}' for name in (
    'schemaLocation', 'noNamespaceSchemaLocation')]
Element = Any
"""What lxml makes; it is published without types."""
_dcc = ElementMaker(namespace=DCC, nsmap={'dcc': DCC, 'si': SI})
_si = ElementMaker(namespace=SI, nsmap={'dcc': DCC, 'si': SI})


def to_xml(certificate: Certificate) -> bytes:
    """Return the document as UTF-8 bytes."""
    root = document(certificate)
    etree.indent(root)
    return bytes(etree.tostring(root, xml_declaration=True, encoding='UTF-8'))


def document(certificate: Certificate) -> Element:
    """Return the root element, without white space between elements."""
    root = _dcc('digitalCalibrationCertificate', schemaVersion=SCHEMA)
    root.append(_administrative(certificate))
    root.append(_dcc('measurementResults', *(_result(certificate, one) for one in certificate.sets)))
    comment = etree.SubElement(root, f'{{{DCC}}}comment')
    etree.SubElement(comment, f'{{{OWN}}}inputs', nsmap={'rosette': OWN}).text = json.dumps(
        _inputs(certificate.inputs), ensure_ascii=False)
    etree.SubElement(comment, f'{{{OWN}}}content', nsmap={'rosette': OWN}, form=CANONICAL, sha256=content_digest(root))
    return root


def content_digest(root: Element) -> str:
    """Return the SHA-256, hex, of what a document says: Canonical XML 2.0 with prefixes and white space rewritten.

    Another program may write the same elements with other prefixes; the element that states the digest is left out, as
    are comments, instructions and hints where schemas lie."""
    bare = copy.deepcopy(root)
    etree.strip_tags(bare, etree.Comment, etree.PI)
    text = etree.canonicalize(etree.tostring(bare, encoding='unicode'), strip_text=True, rewrite_prefixes=True,
                              exclude_tags=[f'{{{OWN}}}content'], exclude_attrs=HINTS)
    return hashlib.sha256(text.encode()).hexdigest()


def earlier_digest(root: Element) -> str:
    """Return the digest that version 0.1 stated: of Canonical XML 1.0, in which prefixes count."""
    bare = copy.deepcopy(root)
    for one in bare.findall(f'{{{DCC}}}comment/{{{OWN}}}content'):
        one.getparent().remove(one)
    for one in bare.iter():
        one.text, one.tail = ((words if words and words.strip() else None) for words in (one.text, one.tail))
    return hashlib.sha256(etree.tostring(bare, method='c14n')).hexdigest()


def _inputs(inputs: Inputs) -> dict[str, Any]:
    """Return what the certificate was made from besides the runs."""
    return {'identity': dict(inputs.identity.entries), 'tolerances': dict(inputs.identity.tolerances),
            'issued': inputs.issued, 'model': inputs.model, 'run_id': inputs.run_id, 'joint': inputs.is_joint,
            'sharing': dict(inputs.sharing), 'budget': inputs.budget, 'programs': inputs.programs,
            **({'columns': inputs.columns.entries} if inputs.columns else {})}


# Who and what -------------------------------------------------------------------------------------


def _administrative(one: Certificate) -> Element:
    identity, core = one.identity, _dcc('coreData')
    for tag, words in (
            ('countryCodeISO3166_1', identity['laboratory.country']), ('usedLangCodeISO639_1', 'en'),
            ('mandatoryLangCodeISO639_1', 'en'), ('uniqueIdentifier', identity['certificate.number']),
            ('beginPerformanceDate', one.days[0]), ('endPerformanceDate', one.days[1]),
            ('performanceLocation', identity['place.at'] or 'other'), ('issueDate', one.inputs.issued)):
        core.append(_dcc(tag, words))
    if order := identity['customer.order']:
        core.insert(4, _dcc('identifications', _identification('customer', order, 'order number')))
    laboratory = _dcc('calibrationLaboratory', _contact('contact', identity, 'laboratory'))
    if code := identity['laboratory.accreditation']:
        laboratory.insert(0, _dcc('calibrationLaboratoryCode', code))
    simulated = ' (SIMULATED)' * one.is_simulated
    return _dcc(
        'administrativeData',
        _dcc('dccSoftware', *_programs(one)), core,
        _dcc('items', _dcc('item', _named(f'rotary table{simulated}'), *_equipment(identity, 'table'))),
        laboratory, _dcc('respPersons', _person(identity, 'signer', identity['signer.role'] or 'signer', True),
                         _person(identity, 'operator', 'operator', False)),
        _contact('customer', identity, 'customer'), _dcc('statements', *_statements(one)))


def _programs(one: Certificate) -> list[Element]:
    return [_dcc('software', _named(name), _dcc('release', release(version)),
                 _dcc('type', 'application' if name == 'rosette_ros' else 'library'),
                 _rich('description', f'{name} {version}'))
            for name, version in one.inputs.programs if version[:1].isdigit()]


def _equipment(identity: Identity, name: str) -> list[Element]:
    """Return description, maker, model and serial number of a device, in the order of an item or of equipment."""
    further = '; '.join(filter(None, (
        f'calibration: {words}' if (words := identity[f'{name}.calibration']) else '', identity[f'{name}.remarks'])))
    maker = _dcc('manufacturer', _named(identity[f'{name}.maker'] or NOT_STATED))
    return [*([_rich('description', further)] if further else []), maker,
            _dcc('model', identity[f'{name}.model'] or NOT_STATED),
            _dcc('identifications', _identification(
                'manufacturer', identity[f'{name}.serial'] or NOT_STATED, 'serial number'))]


def _identification(issuer: str, value: str, name: str) -> Element:
    return _dcc('identification', _dcc('issuer', issuer), _dcc('value', value), _named(name))


def _contact(tag: str, identity: Identity, section: str) -> Element:
    location = [_dcc(one, words) for one, entry in (
        ('city', 'city'), ('countryCode', 'country'), ('postCode', 'postcode'), ('street', 'street'))
        if (words := identity[f'{section}.{entry}'])]
    ways = [_dcc(one, words) for one, entry in (('eMail', 'email'), ('phone', 'phone'))
            if (words := identity[f'{section}.{entry}'])]
    return _dcc(tag, _named(identity[f'{section}.name'] or NOT_STATED), *ways,
                _dcc('location', *(location or [_rich('further', f'address {NOT_STATED}')])))


def _person(identity: Identity, section: str, role: str, signs: bool) -> Element:
    return _dcc('respPerson', _dcc('person', _named(identity[f'{section}.name'] or NOT_STATED)), _dcc('role', role),
                _dcc('mainSigner', str(signs).lower()))


def _statements(one: Certificate) -> list[Element]:
    every = [('SIMULATED', SIMULATED)] * one.is_simulated
    every += [('fit of the model', one.judgement), ('decision rule', f'{DECISION_RULE}.')]
    every += [('limitation', sentence) for sentence in one.unknown]
    every += [('not considered in U', sentence) for sentence in (not_considered(one.budget) if one.budget else ())]
    every += [('missing mandatory data (ISO/IEC 17025, 7.8.2)', f'{words}: {NOT_STATED}.') for words in one.missing]
    every += [('metrological traceability', words)] if (words := one.identity['traceability.name']) else []
    every += [('remarks', words)] if (words := one.identity['certificate.remarks']) else []
    every += [('place', words)] if (words := one.identity['place.name']) else []
    return [_dcc('statement', _named(name), *([_dcc('norm', 'ISO 14253-1')] if name == 'decision rule' else []),
                 _rich('declaration', words)) for name, words in every]


# Results ------------------------------------------------------------------------------------------


def _result(one: Certificate, curves: CurveSet) -> Element:
    simulated = 'SIMULATED: ' * one.is_simulated
    return _dcc(
        'measurementResult', _named(f'{simulated}error motions of the {curves.words}'),
        _rich('description', one.judgement),
        _dcc('usedMethods', _dcc('usedMethod', _named('three-rosette method'), _rich('description', METHOD),
                                 _dcc('norm', 'ISO 230-7'), _dcc('norm', 'VDI/VDE 2617'), _dcc('reference', PAPER),
                                 _dcc('link', DOI))),
        _dcc('usedSoftware', *_programs(one)),
        _dcc('measuringEquipments', *(_dcc(
            'measuringEquipment', _named(DEVICES[name]), *_equipment(one.identity, name))
            for name in DEVICES if name != 'table')),
        _dcc('influenceConditions', *(condition for run in one.runs for condition in _conditions(run)), *(
            _dcc('influenceCondition', _named(name), _dcc('data', _rich('text', words)))
            for name, words in one.conditions if words)),
        _dcc('results', _curves(curves), _dcc(
            'result', _named('error motions after ISO 230-7'), _dcc('data', *(
                _error(line, curves.probability, one.beside_conformity) for line in curves.lines)),
            refType='rosette_iso_230_7'), *([_compensated(one, curves.probability)] if one.compensated else []),
            *([_budget(one.budget)] if one.budget else [])),
        _dcc('measurementMetaData', *(_dcc('metaData', _named(name), _rich('declaration', words))
                                      for name, words in one.evaluation),
             *(_dcc('metaData', _named('measured data'), _dcc('reference', file.path), _dcc('data', _rich(
                 'text', f'SHA-256 {file.sha256}', refType='rosette_sha256')), refType='rosette_file')
               for file in one.files)))


def _conditions(run: Measured) -> Iterable[Element]:
    for name, words in run.rows:
        data = [_rich('text', words)]
        if name == 'Temperature' and run.temperatures.size:
            data += [_quantity(f'{which} temperature', f'rosette_temperature_{which}', value, r'\degreecelsius')
                     for which, value in (('lowest', run.temperatures.min()), ('highest', run.temperatures.max()),
                                          ('mean', run.temperatures.mean()))]
        yield _dcc('influenceCondition', _named(f'{name} of {run.name}' if name != 'Run' else 'Run'),
                   _dcc('data', *data))


def _curves(curves: CurveSet) -> Element:
    motions = curves.motions
    names = text.curve_names(motions.rotation)
    listed = [_quantity('table angle', 'rosette_angle', np.rad2deg(motions.angle), r'\degree')]
    listed += [_quantity(names[place], f'rosette_{curve}', 1e6 * motions.values[:, place], MICRO[unit],
                         1e6 * COVERAGE_FACTOR * motions.u[:, place], curves.probability)
               for place, (curve, unit) in enumerate(SI_UNITS.items())]
    return _dcc('result', _named(f'six error motions of the {curves.words}'),
                _dcc('data', _dcc('list', *listed)), refType='rosette_curves')


def _error(line: AxisError, probability: float, beside: str) -> Element:
    """Return one error as a list of quantities, with its conformity; probability: of U; beside: said with it."""
    unit = MICRO[SI_UNITS[line.curve]]

    def quantity(name: str, key: str, value: float | None, expanded: float | None = None) -> list[Element]:
        return [] if value is None else [_quantity(name, f'rosette_{line.curve}_{key}', 1e6 * value, unit,
                                                   None if expanded is None else 1e6 * expanded, probability)]
    wide = None if line.u_asynchronous is None else COVERAGE_FACTOR * line.u_asynchronous
    ranged = quantity('range (synchronous error motion value)', 'range', line.range, line.expanded)
    if line.tolerance is not None and line.conformity is not None:
        within = 'conditionalPass' if line.range <= line.tolerance else 'conditionalFail'
        stated = 1e6 * line.tolerance  # 15 digits: 350 nm are 0.35 µm, not 0.35000000000000003
        limit = _quantity('tolerance of the range', f'rosette_{line.curve}_tolerance', float(f'{stated:.15g}'), unit)
        ranged[0].append(_dcc('measurementMetaData', _dcc(
            'metaData', _named('conformity'), _dcc('norm', 'ISO 14253-1'), _rich('declaration', '. '.join(filter(None, (
                f'{conformity_words(line)}: {line.doubt or DECISION_RULE}', beside)))),
            *([] if line.doubt else [_dcc('conformity', STATUS.get(line.conformity, within))]), _dcc('data', limit))))
    return _dcc('list', _named(f'{line.curve} ({line.name})'), *ranged,
                *quantity('range of the fundamental error motion', 'once_per_turn', line.once_per_turn),
                *quantity('range of the residual synchronous error motion', 'residual', line.residual),
                *quantity('asynchronous error motion value (width)', 'asynchronous', line.asynchronous, wide),
                refType=f'rosette_line_{line.curve}')


def _compensated(one: Certificate, probability: float) -> Element:
    """Return the effects in the model, which the curves do not contain: a list for each, with its parameters and U."""
    return _dcc('result', _named(COMPENSATED), _dcc('data', *(_dcc(
        'list', _named(words_of(effect.name)),
        *([_rich('description', words)] if (words := setting_words(
            effect.name, effect.setting, [each.name for each in effect.parameters], time=one.time_unit)) else []),
        *(_parameter(each, probability) for each in effect.parameters), refType='rosette_effect')
        for effect in one.compensated)), refType='rosette_effects')


def _parameter(one: Parameter, probability: float) -> Element:
    unit, factor = unit_of(one.unit)
    per = ' per reading' if 'reading' in one.unit else ''
    return _quantity(f'{one.name}{per}', 'rosette_parameter', factor * one.value, unit,
                     factor * COVERAGE_FACTOR * one.u, probability)


def unit_of(si: str) -> tuple[str, float]:
    """Return an SI unit such as m/s^2 as D-SI writes it, lengths and angles in micrometres and microradians, and the
    factor to it. A count, as of readings, is no unit."""
    powers: list[tuple[str, int]] = []
    for place, part in enumerate(si.split('/')):
        name, _, power = part.partition('^')
        if name in BASE:
            powers.append((BASE[name], (1 if place == 0 else -1) * int(power or 1)))
    is_small = bool(powers) and powers[0] in ((r'\metre', 1), (r'\radian', 1))
    words = ''.join(name + f'\\tothe{{{power}}}' * (power != 1) for name, power in powers)
    return (r'\micro' * is_small + words) or r'\one', 1e6 if is_small else 1.0


def _budget(made: Budget) -> Element:
    """Return the uncertainty budget: a list for each contribution, and one of what they make together."""
    u = made.mean
    together = [
        *_by_curve('combined standard uncertainty', 'rosette_budget_u', u),
        *_by_curve(f'expanded uncertainty U, k = {COVERAGE_FACTOR}', 'rosette_budget_U', COVERAGE_FACTOR * u),
        *_by_curve(f'U of the worst point, k = {COVERAGE_FACTOR}', 'rosette_budget_U_worst',
                   COVERAGE_FACTOR * made.combined().max(axis=0)),
        *(_quantity(f'effective degrees of freedom of {curve}', f'rosette_budget_dof_{curve}', dof, r'\one')
          for curve, dof in zip(CURVES, made.effective_dof.tolist(), strict=True) if math.isfinite(dof))]
    return _dcc('result', _named('uncertainty budget (GUM)'),
                _rich('description', NOTE),
                _dcc('data', *map(_contribution, made.contributions), _dcc(
                    'list', _named('all contributions together'), *together, refType='rosette_budget_together')),
                refType='rosette_budget')


def _contribution(one: Contribution) -> Element:
    source = f'; from: {one.source}' if one.source else ''
    return _dcc('list', _named(one.name),
                _rich('description', f'{one.words}; type {one.kind}, {one.distribution}{source}'),
                _quantity('standard uncertainty of the input', 'rosette_budget_input', one.value, UNITS[one.unit]),
                *([_quantity('degrees of freedom', 'rosette_budget_dof', one.dof, r'\one')]
                  if math.isfinite(one.dof) else []),
                *_by_curve('standard uncertainty', 'rosette_budget_contribution', one.mean),
                refType='rosette_budget_line')


# Elements -----------------------------------------------------------------------------------------


def _content(words: str) -> Element:
    return _dcc('content', ''.join(one if one.isprintable() else ' ' for one in words), lang='en')


def _named(words: str) -> Element:
    return _dcc('name', _content(words))


def _rich(tag: str, words: str, **attributes: str) -> Element:
    return _dcc(tag, _content(words), **attributes)


def _quantity(name: str, kind: str, value: float | Floats, unit: str,
              expanded: float | Floats | None = None, probability: float = 1.0) -> Element:
    """Return a number, or numbers (m,), with the expanded uncertainty and its probability.

    D-SI names the parts of a list by a suffix."""
    suffix = 'XMLList' * isinstance(value, np.ndarray)
    if not suffix and not np.isfinite(value):
        return _dcc('quantity', _named(name), _rich('noQuantity', 'not determined'), refType=kind)

    def part(tag: str, *content: Element | str) -> Element:
        return _si(f'{tag}{suffix}', *content)
    real = part('realList' if suffix else 'real', part('value', _numbers(value)), part('unit', unit))
    if expanded is not None and np.isfinite(expanded).all():
        real.append(part('measurementUncertaintyUnivariate', part(
            'expandedMU', part('valueExpandedMU', _numbers(expanded)), part('coverageFactor', str(COVERAGE_FACTOR)),
            part('coverageProbability', f'{probability:.2f}'),
            part('distribution', 'normal' if probability > NEARLY_NORMAL else "Student's t"))))
    return _dcc('quantity', _named(name), real, refType=kind)


def _by_curve(name: str, kind: str, values: Floats) -> Iterable[Element]:
    """Yield lists of a value (6,) of each translation, and of each rotation."""
    for unit, key in (('m', 'translations'), ('rad', 'rotations')):
        which = [place for place, one in enumerate(SI_UNITS.values()) if one == unit]
        yield _quantity(f'{name} of {", ".join(CURVES[place] for place in which)}', f'{kind}_{key}',
                        1e6 * values[which], MICRO[unit])


def _numbers(values: float | Floats) -> str:
    return ' '.join(repr(value + 0.0) for value in np.ravel(values).tolist())
