"""Tables, repositories, object storage and job rows: what services and workers share. The only import of sqlalchemy."""
