"""HTTP API, tile server and operator dashboard."""

from wayloom.config.blas_threads import use_one_blas_thread

use_one_blas_thread()
