"""Kerbside objects of a block: sidewalk furniture, parked vehicles, signals and signs at crossings."""

import numpy as np

from wayloom.simulation.city import furniture
from wayloom.simulation.city.block_context import LIGHT, POLE, SIGN, BlockContext, ChangeState, SignalFace
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.objects import Change
from wayloom.simulation.city.streets import AVENUE_HALF_M, CROSSING_LENGTH_M, F64, Control
from wayloom.simulation.models import vegetation
from wayloom.simulation.models.mesh import Mesh, placed

PARKING_FROM_KERB_M = 1.05
SHELTER_BACK_M = 1.7
TREE, SIGNPOST, BOLLARDS, BIKES, CABINET, MOTORBIKES = range(6)
FURNITURE_SHARES = (0.40, 0.22, 0.11, 0.12, 0.07, 0.08)
LORRY_SHARE, LONG_SHARE, MOTORCYCLES_SHARE = 0.13, 0.22, 0.06
"""Of the vehicles parked along an avenue lorries, and lorries and buses together; of all places those of motorcycles."""
MOTORCYCLE_SPACE_M, MOTORCYCLE_TURN_RAD = 0.95, 1.15
"""Side by side, and how much they are turned from the kerb's line."""


def sidewalk_furniture(context: BlockContext, k: int, clear: tuple[float, float]) -> None:
    """Lamps at even distance, and between them trees, signs, bollards, bicycles, cabinets, motorcycles."""
    shape, rng = context.shape, context.rng
    d, inward, length = shape.edge(k)
    first, last, yaw = clear[0] + 2, length - clear[1] - 2, float(np.arctan2(d[1], d[0]))
    for s in np.arange(first + 3, last, rng.uniform(20, 26)):
        _lamp(context, context.kerb_point(k, s, 0.45), d, -inward)
    for s in np.arange(first + rng.uniform(6, 9), last, rng.uniform(5.5, 9)):
        at, kind = context.kerb_point(k, s, 0.75), rng.choice(len(FURNITURE_SHARES), p=FURNITURE_SHARES)
        if kind == TREE:
            vegetation.broadleaf(context.m, rng, at[0], at[1], context.number(), rng.uniform(0.8, 1.2))
        elif kind == SIGNPOST:
            sign(context, at, d, int(rng.integers(furniture.SIGN_KINDS)))
        elif kind == BOLLARDS:
            for step in range(4):
                number, place = context.number(), at + d * 1.3 * step
                furniture.bollard(context.m, place, number)
                context.note(POLE, number, place, 0.0, furniture.BOLLARD_TOP_M)
        elif kind in (BIKES, MOTORBIKES):
            model = context.models.any_bicycle if kind == BIKES else context.models.any_motorcycle
            for step in range(int(rng.integers(1, 4))):
                turn = yaw + np.pi / 2 + rng.normal(0, 0.15)
                x, y = at + d * 0.7 * step
                context.m.add(placed(model(rng), float(x), float(y), turn, KERB_M, context.number()))
        else:
            furniture.cabinet(context.m, at, yaw, context.number(), rng)
    if shape.half_m[k] == AVENUE_HALF_M:
        furniture.shelter(context.m, context.kerb_point(k, (first + last) / 2, SHELTER_BACK_M), d, -inward, context.number())


def _lamp(context: BlockContext, at: F64, along: F64, to_street: F64) -> None:
    """A street lamp, subject to the changes of a changed city."""
    number, state = context.number(), context.draw_change("pole")
    for place in context.places_after_change(state, POLE, number, at, along):
        furniture.lamp_post(context.m, place, to_street, number)
        context.note(POLE, number, place, 0.0, furniture.LAMP_TOP_M)


def sign(context: BlockContext, at: F64, facing: F64, kind: int) -> None:
    """A sign on its post, subject to the changes of a changed city."""
    post, plate, state = context.number(), context.number(), context.draw_change("sign")
    context.places_after_change(state, POLE, post, at, facing)
    for place in context.places_after_change(state, SIGN, plate, at, facing):
        furniture.sign_post(context.m, place, facing, kind, post, plate)
        context.note(POLE, post, place, 0.0, furniture.SIGN_POST_TOP_M)
        context.note(SIGN, plate, place, *furniture.SIGN_M)


def parked_vehicles(context: BlockContext, k: int, clear: tuple[float, float]) -> None:
    """Vehicles at the kerb, facing as the traffic beside them drives: with the kerb on their right. Long ones along avenues."""
    shape, rng = context.shape, context.rng
    _, _, length = shape.edge(k)
    avenue, full = shape.half_m[k] == AVENUE_HALF_M, rng.uniform(0.35, 0.85)
    s, end = clear[0] + CROSSING_LENGTH_M + 4, length - clear[1] - CROSSING_LENGTH_M - 3
    while s < end:
        chance, needed = rng.random(), rng.uniform(5.4, 6.6)
        if chance < full:
            kind = rng.random()
            if avenue and kind < LONG_SHARE and s + 13 < end:
                lorry = kind < LORRY_SHARE
                mesh = context.models.painted(context.models.lorry if lorry else context.models.bus, rng)
                s, needed, from_kerb = (s + 2.0, 8.0, 1.4) if lorry else (s + 4.0, 10.0, 1.45)
                _park_one(context, k, mesh, s, from_kerb)
            elif kind > 1 - MOTORCYCLES_SHARE:
                for step in range(int(rng.integers(2, 5))):
                    _park_one(
                        context, k, context.models.any_motorcycle(rng), s + MOTORCYCLE_SPACE_M * step, PARKING_FROM_KERB_M, True
                    )
            else:
                _park_one(context, k, context.models.any_car(rng), s, PARKING_FROM_KERB_M)
        s += needed


def _park_one(context: BlockContext, k: int, mesh: Mesh, along_m: float, from_kerb_m: float, slanted: bool = False) -> None:
    """One vehicle at the kerb, subject to the changes of a changed city. Motorcycles stand slanted."""
    rng, (d, _, _) = context.rng, context.shape.edge(k)
    small = from_kerb_m == PARKING_FROM_KERB_M
    at = context.kerb_point(k, along_m, -from_kerb_m + rng.normal(0, 0.05 if small else 0.02))
    scale = (rng.uniform(0.93, 1.06), rng.uniform(0.97, 1.03), rng.uniform(0.97, 1.06)) if small else (1.0, 1.0, 1.0)
    yaw = float(np.arctan2(-d[1], -d[0])) + rng.normal(0, 0.025 if small else 0.004)
    if slanted:
        yaw += MOTORCYCLE_TURN_RAD + rng.normal(0, 0.08)
    number, state, class_id = context.number(), context.draw_change("vehicle"), int(mesh.class_id[0])
    if state is not ChangeState.UNCHANGED:
        context.changes.append(Change("removed", class_id, number, np.array([*at, 0.0])))
    if state is ChangeState.MOVED and context.change_rng is not None:
        mesh = (context.models.any_motorcycle if slanted else context.models.any_car)(context.change_rng)
        context.changes.append(Change("added", int(mesh.class_id[0]), number, np.array([*at, 0.0])))
    if state is not ChangeState.REMOVED:
        context.m.add(placed(mesh, at[0], at[1], yaw, 0.0, number, scale))


def crossing_furniture(context: BlockContext, k: int, clear: tuple[float, float]) -> None:
    """Traffic lights or signs for traffic along edge k towards its first node, and railings at some corners."""
    shape, rng = context.shape, context.rng
    d, _, _ = shape.edge(k)
    at = context.kerb_point(k, clear[0] + 4.4, 0.55)
    control, chance = context.graph.control(shape.nodes[k]), rng.random()
    if control is Control.SIGNALS:
        _signal(context, k, at, 3.8 if shape.half_m[k] == AVENUE_HALF_M or chance < 0.4 else 0.0)
    else:
        sign(context, at, d, 3 if control is Control.ROUNDABOUT else int(rng.choice((3, 5, 2))))
    sign(context, context.kerb_point(k, clear[0] + 0.4, 0.6), d, 7)
    if rng.random() < 0.4:
        a, b = (context.kerb_point(k, clear[0] + s, 0.3) for s in (5.0, 11.0))
        furniture.guard_rail(context.m, a, b, context.number())


def _signal(context: BlockContext, k: int, at: F64, arm_m: float) -> None:
    """A traffic light whose heads each have a number of their own."""
    d, inward, _ = context.shape.edge(k)
    post, node, origin = context.number(), context.shape.nodes[k], context.shape.nodes[(k + 1) % 4]
    heads = furniture.traffic_light(context.m, at, d, -inward, arm_m, post, [context.number() for _ in range(1 + (arm_m > 0))])
    context.note(POLE, post, at, 0.0, furniture.signal_post_m(arm_m))
    for face, number in heads:
        context.faces.append(SignalFace(face, d, node, origin, number))
        context.note(LIGHT, number, face[:2] - d * furniture.SIGNAL_HALF_M, face[2], face[2] + furniture.SIGNAL_M)
