"""Records of matrix systems: their algebra, and the arrays that define their stream."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.families.matrix_algebra import MAX_MATRIX_SIZE, SUM, MatrixAlgebra
from coadjoint.files.records.entries import ENERGY, EXACT, STREAM, Entry, as_value_errors
from coadjoint.memory import check_available_memory
from coadjoint.systems.matrices.matrix_system import MAX_POWERS, MatrixSystem
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem

RECORD_KEYS = ("name", "matrices", "layers", "stream", "second_stream", "linear", "energy_sign", "powers", "not_stored")


def matrix_record(system: MatrixSystem) -> dict[str, Any]:
    """Return a matrix system as plain numbers, lists and text; streams that are functions are not stored."""
    record: dict[str, Any] = {
        "name": system.name,
        "matrices": _algebra_record(system.algebra),
        "energy_sign": system.energy_sign,
        "powers": system.powers,
    }
    missing = []
    stream = _stream_record(system.stream)
    if stream is None:
        function = getattr(system.stream, "function", system.stream)
        missing.append(f"{STREAM}{getattr(function, '__name__', type(function).__name__)}")
    else:
        record["stream"] = stream
    if isinstance(system, TwoLayerSystem):
        record["layers"] = 2
        second = None if system.second_stream is None else _stream_record(system.second_stream)
        if second is not None:
            record["second_stream"] = second
        elif system.second_stream is not None:
            missing.append(f"{STREAM}{type(system.second_stream).__name__}")
    if system.linear is not None:
        record["linear"] = _matrix_record(system.linear)
    if system.energy_function is not None:
        missing.append(f"{ENERGY}{getattr(system.energy_function, '__name__', type(system.energy_function).__name__)}")
    if system.closed_form is not None:
        missing.append(f"{EXACT}{getattr(system.closed_form, '__name__', type(system.closed_form).__name__)}")
    return {**record, "not_stored": missing} if missing else record


def matrix_system_of(record: Entry) -> MatrixSystem:
    """Rebuild the matrix system of a record; ValueError if the record is damaged."""
    algebra = _algebra_of(record.reject_unknown(*RECORD_KEYS)["matrices"])
    with as_value_errors(record):
        check_available_memory(300 * algebra.N**2, f"matrices of {algebra}")
    stream = _stream_of(record["stream"], algebra.N)
    linear = _matrix_of(record["linear"], algebra) if "linear" in record else None
    sign, powers, name = record["energy_sign"].integer(-1, 1), record["powers"].integer(0, MAX_POWERS), record["name"]
    if "layers" in record:
        record["layers"].integer(2, 2)
        second = _stream_of(record["second_stream"], algebra.N) if "second_stream" in record else None
        with as_value_errors(record):
            return TwoLayerSystem(algebra, stream, second, energy_sign=sign, name=name.text(), powers=powers)
    with as_value_errors(record):
        return MatrixSystem(algebra, stream, linear, energy_sign=sign, name=name.text(), powers=powers)


def _algebra_record(algebra: MatrixAlgebra) -> dict[str, Any]:
    if algebra.blocks:
        return {"blocks": [_algebra_record(block) for block in algebra.blocks]}
    return {"kind": algebra.kind, "N": algebra.N, "q": algebra.q}


def _algebra_of(record: Entry) -> MatrixAlgebra:
    if "blocks" in record:
        blocks = [_algebra_of(block) for block in record.reject_unknown("blocks")["blocks"].entries()]
        with as_value_errors(record):
            return MatrixAlgebra.sum(*blocks)
    record.reject_unknown("kind", "N", "q")
    kind, N, q = record["kind"].text(), record["N"].integer(2, MAX_MATRIX_SIZE), record["q"].integer(0, MAX_MATRIX_SIZE)
    with as_value_errors(record):
        if kind == SUM:
            raise ValueError("a sum has blocks")
        return MatrixAlgebra(kind, N, q)


def _stream_record(stream: Any) -> dict[str, Any] | None:
    if type(stream) is Weights:
        return {"weights": stream.weights.tolist()}
    if type(stream) is DiagonalSolve:
        return {"main": stream.main.tolist(), "beside": stream.beside.tolist(), "factor": float(stream.factor)}
    if type(stream) is Inverse:
        return {"inverse of": _stream_record(stream.of)}
    if type(stream) is Circulants:
        return {"spectrum": stream.spectrum.tolist()}
    return None


def _stream_of(record: Entry, N: int) -> Any:
    table = record.table()
    if "weights" in table:
        weights = _square(record.reject_unknown("weights")["weights"], N)
        with as_value_errors(record):
            return Weights(weights)
    if "spectrum" in table:
        spectrum = _square(record.reject_unknown("spectrum")["spectrum"], N)
        with as_value_errors(record):
            return Circulants(spectrum)
    if "inverse of" in table:
        of = _stream_of(record.reject_unknown("inverse of")["inverse of"], N)
        with as_value_errors(record):
            if not isinstance(of, DiagonalSolve):
                raise ValueError("the inverse is that of a stream with main and beside")
            return Inverse(of)
    record.reject_unknown("main", "beside", "factor")
    main, beside, factor = _square(record["main"], N), _square(record["beside"], N), record["factor"].number()
    with as_value_errors(record):
        return DiagonalSolve(main, beside, factor)


def _square(record: Entry, N: int) -> NDArray[np.float64]:
    return np.array([row.numbers(N) for row in record.entries(N)])


def _matrix_record(matrix: NDArray[Any]) -> list[Any]:
    return [matrix.real.tolist(), matrix.imag.tolist()] if np.iscomplexobj(matrix) else [matrix.tolist()]


def _matrix_of(record: Entry, algebra: MatrixAlgebra) -> NDArray[Any]:
    parts = [_square(part, algebra.N) for part in record.entries(1 + algebra.complex)]
    return parts[0] + 1j * parts[1] if algebra.complex else parts[0]
