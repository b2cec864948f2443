"""Lanes that look at different places of a block, and rows of numbers turned into lanes."""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import (
    F64,
    I32,
    I64,
    INT_VEC,
    LANES,
    VEC,
    fma,
    intrinsic,
    load,
    splat,
)


def splat_whole(b: ir.IRBuilder, scalar: ir.Value) -> ir.Value:
    undefined = ir.Constant(INT_VEC, ir.Undefined)
    one = b.insert_element(undefined, scalar, I32(0))
    lanes = ir.Constant(ir.VectorType(I32, LANES), [0] * LANES)
    return b.shuffle_vector(one, undefined, lanes)


def largest(b: ir.IRBuilder, values: ir.Value) -> ir.Value:
    """Of whole numbers."""
    name = f"llvm.vector.reduce.smax.v{LANES}i64"
    return b.call(intrinsic(b.module, name, I64, [INT_VEC]), [values])


def anywhere(b: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    return b.icmp_unsigned("!=", b.bitcast(mask, ir.IntType(LANES)), ir.IntType(LANES)(0))


def gather(b: ir.IRBuilder, numbers: ir.Value, places: ir.Value) -> ir.Value:
    """Of a block of single numbers, at the place of each lane; quick where lanes have one place."""
    first = b.extract_element(places, I32(0))
    other = b.icmp_signed("!=", places, splat_whole(b, first))
    with b.if_else(anywhere(b, other)) as (then, otherwise):
        with then:
            apart: ir.Value = ir.Constant(VEC, ir.Undefined)
            for lane in range(LANES):
                number = b.load(b.gep(numbers, [b.extract_element(places, I32(lane))]))
                apart = b.insert_element(apart, number, I32(lane))
            block_apart = b.block
        with otherwise:
            alike = splat(b, b.load(b.gep(numbers, [first])))
            block_alike = b.block
    found = b.phi(VEC)
    found.add_incoming(apart, block_apart)
    found.add_incoming(alike, block_alike)
    return found


def gather_own(b: ir.IRBuilder, vectors: ir.Value, places: ir.Value) -> ir.Value:
    """Of a block of vectors, each lane's number of the vector at its place."""
    first = b.extract_element(places, I32(0))
    other = b.icmp_signed("!=", places, splat_whole(b, first))
    numbers = b.bitcast(vectors, F64.as_pointer())
    with b.if_else(anywhere(b, other)) as (then, otherwise):
        with then:
            apart: ir.Value = ir.Constant(VEC, ir.Undefined)
            for lane in range(LANES):
                vector_of = b.mul(b.extract_element(places, I32(lane)), I64(LANES))
                number = b.load(b.gep(numbers, [b.add(vector_of, I64(lane))]))
                apart = b.insert_element(apart, number, I32(lane))
            block_apart = b.block
        with otherwise:
            alike = b.load(b.gep(vectors, [first]), align=8)
            block_alike = b.block
    found = b.phi(VEC)
    found.add_incoming(apart, block_apart)
    found.add_incoming(alike, block_alike)
    return found


def scatter(b: ir.IRBuilder, value: ir.Value, numbers: ir.Value, places: ir.Value) -> None:
    """Lane l of `value` to number l of the vector at the place of the lane."""
    for lane in range(LANES):
        vector_of = b.mul(b.extract_element(places, I32(lane)), I64(LANES))
        place = b.gep(numbers, [b.add(vector_of, I64(lane))])
        b.store(b.extract_element(value, I32(lane)), place)


def turned(b: ir.IRBuilder, rows: list[ir.Value]) -> list[ir.Value]:
    """The transpose of LANES vectors: halves of pairs are exchanged, then quarters, then eighths."""
    rows = list(rows)
    for size in (1, 2, 4):
        for one in (i for i in range(LANES) if not i & size):
            first, second = rows[one], rows[one + size]
            low = [j if not j & size else LANES + j - size for j in range(LANES)]
            high = [j + size if not j & size else LANES + j for j in range(LANES)]
            for row, order in ((one, low), (one + size, high)):
                lanes = ir.Constant(ir.VectorType(I32, LANES), order)
                rows[row] = b.shuffle_vector(first, second, lanes)
    return rows


def dot(b: ir.IRBuilder, base: ir.Value, first: int, values: list[ir.Value]) -> ir.Value:
    """Of the vectors at `base` from `first` on with `values`."""
    total = b.fmul(load(b, base, first), values[0])
    for place, value in enumerate(values[1:], start=first + 1):
        total = fma(b, load(b, base, place), value, total)
    return total
