"""Engines: what tasks are spread over. Any executor of the standard interface can be one."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.core.tasks.disposable import close_all

DASK = "dask"
ADDRESS = "dask://"
CONNECTING_S = 10
RETRIES = 3  # of a task whose worker was lost


@dataclass(frozen=True)
class Engine:
    """An executor whose workers make calls in disposable processes.

    Args:
        executor: of the standard interface.
        slots: tasks that it makes at the same time.
        alive: whether it can still answer.
    """

    executor: Executor
    slots: int
    alive: Callable[[], bool] = lambda: True


@contextmanager
def open_engine(name: str = "processes", jobs: int = 1) -> Iterator[Engine]:
    """An engine by name: ``processes`` of this machine, ``dask`` with workers on this machine, or
    ``dask://HOST:PORT``, a scheduler that runs already.

    Args:
        name: as above.
        jobs: tasks at the same time; a scheduler that runs already has its own workers.

    Raises:
        TiltcalError: an unknown name, less than one job, or no scheduler there.
    """
    if jobs < 1:
        raise TiltcalError("option -j", found=f"{jobs}", need="1 or more", do="correct it")
    if name == "processes":
        with _processes(jobs) as engine:
            yield engine
    elif name == DASK or name.startswith(ADDRESS):
        with _dask(name.removeprefix(ADDRESS) if name != DASK else None, jobs) as engine:
            yield engine
    else:
        raise TiltcalError(
            "option --engine",
            found=name,
            need="processes, dask or dask://HOST:PORT",
            do="correct it",
        )


@contextmanager
def shared_engine(name: str = "processes", jobs: int = 1) -> Iterator[Engine | None]:
    """An engine, or None, this process, for one job without another engine."""
    if jobs == 1 and name == "processes":
        yield None
    else:
        with open_engine(name, jobs) as engine:
            yield engine


@contextmanager
def _processes(jobs: int) -> Iterator[Engine]:
    """Threads of this process that wait for disposable ones."""
    executor = ThreadPoolExecutor(jobs, thread_name_prefix="task")
    try:
        yield Engine(executor, jobs)
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        close_all()
        executor.shutdown(wait=True)


@contextmanager
def _dask(address: str | None, jobs: int) -> Iterator[Engine]:
    """A scheduler at an address, or one on this machine with so many workers."""
    try:
        import logging

        from distributed import LocalCluster

        logging.getLogger("distributed").setLevel(
            logging.CRITICAL
        )  # the engine reports it in one line
    except ImportError as error:
        raise TiltcalError(
            "option --engine",
            found="no package distributed",
            need="Dask",
            do="install tiltcal[cluster]",
        ) from error
    make_cluster: Any = LocalCluster
    with ExitStack() as stack:
        position: Any = f"tcp://{address}"
        if address is None:
            position = stack.enter_context(
                make_cluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None)
            )
        client = stack.enter_context(_client(position))
        executor = client.get_executor(pure=False, retries=RETRIES)
        alive = ("running", "connecting")
        yield Engine(executor, sum(client.nthreads().values()), lambda: client.status in alive)


def _client(position: Any) -> Any:
    """A client of a scheduler that has workers."""
    from distributed import Client

    make: Any = Client
    try:
        client = make(position, timeout=CONNECTING_S)
    except (OSError, ValueError) as error:
        raise TiltcalError(
            "option --engine",
            found=f"no Dask scheduler at {position}: {error}",
            need="the address that `dask scheduler` prints",
            do="start it, or correct the address",
        ) from error
    if not client.nthreads():
        client.close()
        raise TiltcalError(
            "option --engine",
            found=f"a Dask scheduler at {position} without workers",
            need="at least one",
            do="start `dask worker`",
        )
    return client
