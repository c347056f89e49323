# SPDX-License-Identifier: Apache-2.0
"""The rules of a Schematron file (ISO/IEC 19757-3) with XPath 2.0, carried out on a document.

Of each pattern the first rule whose context a node matches is used for it. A report is told where its test is true, an
assert where it is false; xsl:comment and value-of are not carried out."""

from typing import NamedTuple

from elementpath import ElementNode, XPath2Parser, XPathContext, get_node_tree
from lxml import etree

SCH = '{http://purl.oclc.org/dsdl/schematron}'
DEFAULT = {'xs': 'http://www.w3.org/2001/XMLSchema', 'xml': 'http://www.w3.org/XML/1998/namespace'}


class Told(NamedTuple):
    """What a rule says: role (error, warning, information), its words, and where."""

    role: str
    words: str
    place: str


class Schematron:
    """The rules of a file; `rules` is how many there are."""

    def __init__(self, path):
        root = etree.parse(path, etree.XMLParser(no_network=True)).getroot()
        self._parser = XPath2Parser(
            {**DEFAULT, **{one.get('prefix'): one.get('uri') for one in root.iter(f'{SCH}ns')}})
        self._patterns = root.findall(f'{SCH}pattern')
        self._parsed = {}
        self.rules = len(root.findall(f'.//{SCH}rule'))

    def told(self, document):
        """Return what the rules say of a document (an lxml element), in the order of the file."""
        tree, every = get_node_tree(document.getroottree()), []
        for pattern in self._patterns:
            known = self._variables(pattern, tree, tree, {})
            used = set()
            for rule in pattern.findall(f'{SCH}rule'):
                context = rule.get('context')
                path = context if context.startswith('/') else f'//{context}'
                for node in self._found(path, tree, tree, known):
                    if node not in used:
                        used.add(node)
                        every += self._check(rule, tree, node, known)
        return every

    def _check(self, rule, tree, node, known):
        known = self._variables(rule, tree, node, known)
        for one in rule:
            if one.tag in (f'{SCH}assert', f'{SCH}report'):
                token = self._token(f'boolean({one.get("test")})')
                holds = token.evaluate(XPathContext(tree, item=node, variables=known))
                if holds == (one.tag == f'{SCH}report'):
                    where = node if isinstance(node, ElementNode) else node.parent
                    yield Told(one.get('role'), ' '.join(''.join(one.itertext()).split()), where.path)

    def _variables(self, parent, tree, node, known):
        known = dict(known)
        for one in parent.findall(f'{SCH}let'):
            known[one.get('name')] = self._found(one.get('value'), tree, node, known)
        return known

    def _found(self, path, tree, node, known):
        return list(self._token(path).select(XPathContext(tree, item=node, variables=known)))

    def _token(self, path):
        if path not in self._parsed:
            self._parsed[path] = self._parser.parse(path)
        return self._parsed[path]
