"""Tables of the database, by what they tell of. All are known as soon as one of them is: the migration check compares them all."""

from wayloom.store.tables import access, drives, maps, rigs

__all__ = ("access", "drives", "maps", "rigs")
