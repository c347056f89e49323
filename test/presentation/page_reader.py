# SPDX-License-Identifier: Apache-2.0
"""A page as a reader without a browser sees it: elements, attributes, texts by section."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Elements (tag, attributes) in order, and the text of each section by its id."""

    def __init__(self, text):
        """Read a page."""
        super().__init__()
        self.elements, self.texts, self._section, self._style = [], {}, '', False
        self.styles = ''
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        """Take note of an element."""
        found = dict(attributes)
        self.elements.append((tag, found))
        if tag == 'section':
            self._section = found['id']
        self._style = tag == 'style'

    def handle_endtag(self, tag):
        """Leave a section."""
        if tag == 'section':
            self._section = ''
        self._style = False

    def handle_data(self, data):
        """Collect text, that of style sheets apart."""
        if self._style:
            self.styles += data
        else:
            self.texts[self._section] = self.texts.get(self._section, '') + data

    @property
    def sections(self):
        """The ids of the sections, in order."""
        return [found['id'] for tag, found in self.elements if tag == 'section']

    def values(self, *names):
        """Return the values of attributes of these names."""
        return [value for _, found in self.elements for name, value in found.items() if name in names]
