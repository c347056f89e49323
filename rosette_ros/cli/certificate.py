# SPDX-License-Identifier: Apache-2.0
"""rosette certificate: a digital calibration certificate of a run, pages for people, and the check of one."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from rosette_ros.api.documents import certificate_of, write_certificate
from rosette_ros.certificate.dcc_check import MOST_BYTES, Verified, verify_certificate
from rosette_ros.certificate.statements import Certificate
from rosette_ros.cli.arguments import SHARED, UsageError, add_shared
from rosette_ros.cli.console import console, doing, print_json, print_parts, print_verdict
from rosette_ros.cli.opened import add_joint, is_joint
from rosette_ros.io.csv_parser import read_columns
from rosette_ros.io.text_file import bare_name, read_limited, refuse_output
from rosette_ros.presentation.budget_results import contributions
from rosette_ros.presentation.error_results import TITLE, errors
from rosette_ros.presentation.identity_words import SIMULATED


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what the verb takes."""
    add_shared(parser, 'run_path', nargs='+')
    add_shared(parser, '--run-id', '--columns', '--model', '--identity')
    add_joint(parser)
    parser.add_argument('-o', '--output', metavar='FILE', help='the certificate to write, XML (default: named as the '
                        'run, in this folder)')
    parser.add_argument('--pdf', metavar='FILE', help='write it for people, too, the XML attached')
    add_shared(parser, '--inputs', help=f'{SHARED["--inputs"]["help"]}; U is that of the budget then')
    add_shared(parser, '--environment', '--angle-unit')
    parser.add_argument('--verify', metavar='CERT', help='compare a certificate with its run instead: curves, hash, '
                        'all that is in it')
    add_shared(parser, '--json', help='with --verify: print one JSON object and nothing else')
    add_shared(parser, '--force')


def run(options: Namespace) -> None:
    """Write a certificate, or check one."""
    if options.verify:
        check(options)
    elif options.json:
        raise UsageError('--json: expected it with --verify; a certificate is a file (XML); leave it out')
    else:
        make(options)


def make(options: Namespace) -> None:
    """Write the certificate of a run, or of several as one."""
    path = Path(options.output or f'{bare_name(options.run_path[0])}.xml')
    for word, name, ending in (('-o', path, '.xml'), ('--pdf', options.pdf, '.pdf')):
        if not name:
            continue
        one = Path(name)
        if one.suffix.lower() != ending:
            raise UsageError(f'{word}: expected a name that ends in {ending}, found {str(name)!r}; -o names the XML, '
                             '--pdf '
                             'the pages for people')
        refuse_output(one, options.force)
    certificate = certificate_of(options.run_path, options.model, options.run_id, options.identity, options.inputs,
                                 options.environment, options.share, is_joint(options), ask, doing,
                                 read_columns(options.columns))
    write_certificate(certificate, path, options.pdf, options.identity, options.force)
    show(certificate, path, options.pdf)


def ask(missing: Sequence[str]) -> None:
    """Print the mandatory data that are not stated, in words."""
    console().print(f'[yellow]Missing mandatory data (ISO/IEC 17025, 7.8.2): {escape(", ".join(missing))}[/]')


def show(certificate: Certificate, path: Path, pdf: str | None) -> None:
    """Print what the certificate says, and what to do, which does not stand in it."""
    out = console()
    if certificate.is_simulated:
        out.print(f'[red]{SIMULATED}[/]')
    if certificate.verdict:
        print_verdict(out, certificate.verdict)
    else:
        out.print(escape(certificate.judgement))
    print_parts(out, [errors(one.lines, TITLE.format(one.words)) for one in certificate.sets])
    if certificate.budget and certificate.inputs.budget:
        print_parts(out, [contributions(certificate.budget)])
    out.print()
    for words in certificate.contradictions:
        out.print(f'[yellow]Contradiction: {escape(words)}[/]')
    out.print(f'[bold]Certificate[/]  {escape(str(path))}', soft_wrap=True)
    if pdf:
        out.print(f'[bold]Pages[/]        {escape(pdf)}', soft_wrap=True)


def check(options: Namespace) -> None:
    """Compare a certificate with its run; raises InvalidData where it is another one."""
    for name in ('output', 'pdf', 'run_id', 'columns', 'identity', 'model', 'joint', 'share', 'inputs', 'environment',
                 'force'):
        if getattr(options, name):
            raise UsageError(f'--{name.replace("_", "-")}: does not go with --verify, which takes all from the '
                             'certificate; leave it out')
    data = read_limited(options.verify, 'a certificate', MOST_BYTES)
    with doing('making the certificate again'):
        found = verify_certificate(data, options.verify, options.run_path)
    if options.json:
        print_json({'schema': 'rosette-certificate-check/1', 'verified': True,
                    'largest_difference': 1e-6 * found.largest, 'signed': found.is_signed, 'programs': found.programs})
    else:
        console().print(words_of(found, options), soft_wrap=True)


def words_of(found: Verified, options: Namespace) -> str:
    """Return in words what was compared and what was not."""
    other = (f' It was made by {found.programs}: only its numbers and the hash are compared.' if found.programs else
             ' An earlier version made it: only its numbers and the hash are compared.' if found.is_earlier else
             ' All that is in it follows from the run and from what it states itself.')
    signature = 'its signature is not checked here' if found.is_signed else 'it carries no signature'
    return (f'[green]{escape(options.verify)} is the certificate of {escape(", ".join(options.run_path))}[/]: the hash '
            f'of the data is right, numbers differ by at most {found.largest:.1g} µm or µrad.{other} Not checked: who '
            f'made it ({signature}), and whether the identity is true.')


IMPLEMENTED = {'certificate': (add_arguments, run)}
