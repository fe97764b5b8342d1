"""Sign-in of operators by an OpenID provider: authorisation code flow with PKCE, ending in a session like any other."""
