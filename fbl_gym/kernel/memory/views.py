"""Records and arrays inside a batch's memory, without copies, reference counts or checks."""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from fbl_gym.kernel.maths.fastmath import inline_njit


@intrinsic
def record_at(_context, memory, _index, dtype):
    """Return the record of a structured type that begins at memory[_index]."""
    record = dtype.dtype

    def emit(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        pointer = builder.gep(array.data, [arguments[1]])
        return builder.bitcast(pointer, context.get_value_type(record))

    return record(memory, types.intp, dtype), emit


def _view(context, builder, array_type, place, lengths):
    """Return an array that begins at a place, row by row."""
    view = context.make_array(array_type)(context, builder)
    itemsize = context.get_abi_sizeof(view.data.type.pointee)
    strides = [context.get_constant(types.intp, itemsize)]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(view, builder.bitcast(place, view.data.type), lengths, strides, itemsize, None)
    return view._getvalue()


@intrinsic
def array_at(_context, memory, _index, shape, dtype):
    """Return the array of a shape (a tuple of int64) and type that begins at memory[_index]."""
    array_type = types.Array(dtype.dtype, len(shape), "C")

    def emit(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        place = builder.gep(array.data, [arguments[1]])
        return _view(context, builder, array_type, place, cgutils.unpack_tuple(builder, arguments[2]))

    return array_type(memory, types.intp, shape, dtype), emit


@intrinsic
def numbers_at(_context, _address, _length, dtype):
    """Return the array of a type at an address."""
    array_type = types.Array(dtype.dtype, 1, "C")

    def emit(context, builder, _signature, arguments):
        place = builder.inttoptr(arguments[0], cgutils.voidptr_t)
        return _view(context, builder, array_type, place, arguments[1:2])

    return array_type(types.int64, types.int64, dtype), emit


@inline_njit
def pair(rows, lane):
    """Return both joints' numbers of a lane."""
    return rows[0, lane], rows[1, lane]


@inline_njit
def put(rows, lane, values):
    """Set both joints' numbers of a lane."""
    rows[0, lane], rows[1, lane] = values
