"""Access control in the database: keys, users, sessions, owners of drives, quotas, and the audit log."""
