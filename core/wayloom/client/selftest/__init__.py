"""One service tried from outside: does it speak tus, and is nothing lost when links break."""
