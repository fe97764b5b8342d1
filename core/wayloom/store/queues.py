"""Settings that every Celery application of wayloom shares. The catalogue of stages says which stage waits in which queue.

Jobs are recovered from their rows by the sweeper, never by the broker: messages are acknowledged early, none is prefetched, there
is no result backend, and nothing waits in a worker's memory. So the broker may lose everything and only seconds are lost.
"""

from typing import Any, Final

from wayloom.config.stages import REMOVAL

TASK_NAME: Final = "wayloom.run_job"


def celery_settings(broker_url: str) -> dict[str, Any]:
    """What to hand to `Celery(...).conf.update`. The task carries nothing but a job's id."""
    return {
        "broker_url": broker_url,
        "task_serializer": "json",
        "accept_content": ["json"],
        "task_ignore_result": True,
        "task_acks_late": False,
        "worker_prefetch_multiplier": 1,
        "worker_disable_prefetch": True,
        "worker_enable_remote_control": False,
        "worker_send_task_events": False,
        "broker_connection_retry_on_startup": True,
        "broker_transport_options": {
            "global_keyprefix": "wayloom:",
            "visibility_timeout": 6 * 3600,
            "unacked_restore_interval": 10,
            "health_check_interval": 25,
            "socket_connect_timeout": 5,
            "max_retries": 3,
        },
        "task_default_queue": REMOVAL.queue,
        "task_publish_retry_policy": {"max_retries": 1, "interval_start": 0},  # a new connection at once; whoever asked waits
        "worker_hijack_root_logger": False,
    }
