"""Celery application and task shells of wayloom: a task claims a job row and runs one stage of the pipeline."""

from wayloom.config.blas_threads import use_one_blas_thread
from wayloom.config.one_heap import use_one_heap
from wayloom.config.rare_collection import collect_rarely

use_one_blas_thread()
use_one_heap()
collect_rarely()
