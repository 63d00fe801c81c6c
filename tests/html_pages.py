"""Parses and checks an HTML page without a browser."""

from html.parser import HTMLParser

EVIL = "</script><script>alert('x')</script>&"


class Reader(HTMLParser):
    """Parser that fails on badly nested elements, and keeps ids, text and addresses to load."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.text: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "link", "img", "input"):
            self.open.append(tag)
        names = dict(attrs)
        self.ids += [str(names["id"])] if "id" in names else []
        self.addresses += [str(v) for k, v in attrs if k in ("src", "href", "srcset", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)


def check_page(page: str) -> Reader:
    """Check that a page is well formed and loads no other file; return the parsed page."""
    reader = Reader(page)
    assert len(set(reader.ids)) == len(reader.ids)
    assert {address[:5] for address in reader.addresses} == {"data:"}
    assert "default-src 'none'" in page
    for word in ("@import", "url(", "http:", "https:", "fetch(", "XMLHttpRequest", "import("):
        assert word not in page
    assert "alert('x')" not in page
    assert page.count("<script") == 2
    return reader
