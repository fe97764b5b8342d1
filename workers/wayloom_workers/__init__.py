"""Celery application and task shells of wayloom: a task claims a job row and runs one stage of the pipeline."""
