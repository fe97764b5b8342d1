"""Page of a sign-in that did not succeed, for whom a browser brings there; programs get the problem as JSON."""

from fastapi import Request, Response
from fastapi.responses import HTMLResponse
from markupsafe import Markup

from wayloom_services.errors import ProtocolError, answer_to

PAGE = Markup("""<!doctype html>
<html lang="en">
  <head>
    <meta charset="utf-8">
    <meta name="viewport" content="width=device-width, initial-scale=1">
    <meta name="color-scheme" content="light dark">
    <title>wayloom: not signed in</title>
    <link rel="icon" href="/static/icon.svg" type="image/svg+xml">
    <link rel="stylesheet" href="/static/style.css">
  </head>
  <body class="page">
    <header>
      <img src="/static/icon.svg" alt="" width="22" height="22">
      <h1><a href="/">wayloom</a></h1>
    </header>
    <main class="narrow">
      <section aria-label="Not signed in">
        <h2>You are not signed in</h2>
        <p id="problem" class="error" role="alert">{detail}</p>
        <p><a href="/sign-in">Back to the sign-in</a></p>
      </section>
    </main>
  </body>
</html>
""")


def refusal(request: Request, error: ProtocolError) -> Response:
    """The answer to a request that ends so: a page where it asks for one, else problem+json."""
    if "text/html" not in request.headers.get("accept", ""):
        return answer_to(error)
    return HTMLResponse(PAGE.format(detail=str(error)), error.status, error.headers)
