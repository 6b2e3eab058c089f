"""Web page: what the vehicle does, in any browser, and a stop that says whether it worked.

A program beside the gateway and a client of its API: one subscription however many browsers look.
`application` puts it together and listens; `page/` is what a browser loads. It is
never a source of demand. docs/web.md has the threat model.
"""
