"""A reader of the part of OpenSCAD's language that the exported source uses; solids by manifold3d.

Written from the language's manual, so that what the program writes is understood by something else than itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import manifold3d
import numpy as np

_TOKEN = re.compile(r"\s+|//[^\n]*|(?P<number>(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)|(?P<name>\$?\w+)|(?P<sign>==|!=|>=|<=|.)")
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sqrt": math.sqrt,
    "abs": abs,
    "norm": lambda v: math.hypot(*v),
    "sin": lambda a: math.sin(math.radians(a)),
    "tan": lambda a: math.tan(math.radians(a)),
}
Solid = manifold3d.Manifold


def solid_of_source(source: str) -> Solid:
    """The solid that a program describes."""
    return _Program(source).run()


class _Program:
    def __init__(self, source: str) -> None:
        self.tokens = [m.group(0) for m in _TOKEN.finditer(source) if m.lastgroup]
        self.at = 0
        self.modules: dict[str, tuple[list[str], int]] = {}

    def run(self) -> Solid:
        return _union(self.statements({"PI": math.pi}, end=None))

    def peek(self) -> str | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def take(self, expected: str | None = None) -> str:
        token = self.tokens[self.at]
        assert expected in (None, token), (
            f"found {token!r}, expected {expected!r} at {self.tokens[self.at - 9 : self.at]}"
        )
        self.at += 1
        return token

    def statements(self, scope: dict[str, Any], end: str | None) -> list[Solid]:
        found: list[Solid] = []
        while self.peek() != end:
            found += self.statement(scope)
        return found

    def statement(self, scope: dict[str, Any]) -> list[Solid]:
        """Read one statement; what it makes."""
        if self.peek() == "{":
            self.take()
            found = self.statements(dict(scope), "}")
            self.take("}")
            return found
        if self.peek() == ";":
            self.take()
            return []
        name = self.take()
        if name == "module":
            module = self.take()
            self.take("(")
            names = []
            while self.peek() != ")":
                names.append(self.take())
                if self.peek() == ",":
                    self.take()
            self.take(")")
            self.modules[module] = (names, self.at)
            self.skip()
            return []
        if self.peek() == "=":
            self.take()
            scope[name] = self.expression(scope)
            self.take(";")
            return []
        return self.call(name, scope)

    def skip(self) -> None:
        """Pass over one statement without running it."""
        depth = 0
        while True:
            token = self.take()
            depth += (token in "({[") - (token in ")}]")
            if depth == 0 and token in (";", "}"):
                return

    def call(self, name: str, scope: dict[str, Any]) -> list[Solid]:
        if name == "for":
            self.take("(")
            variable = self.take()
            self.take("=")
            values = self.expression(scope)
            self.take(")")
            start, found = self.at, []
            for value in values:
                self.at = start
                found += self.statement(scope | {variable: value})
            return [_union(found)]
        if name == "if":
            self.take("(")
            condition = self.expression(scope)
            self.take(")")
            if condition:
                return self.statement(scope)
            self.skip()
            return []
        given, named = self.arguments(scope)
        if name in self.modules:
            names, body = self.modules[name]
            self.take(";")
            back, self.at = self.at, body
            found = self.statement(scope | dict(zip(names, given, strict=True)) | named)
            self.at = back
            return [_union(found)]
        return [_make(name, given, named, self.statement(scope))]

    def arguments(self, scope: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        given, named = [], {}
        self.take("(")
        while self.peek() != ")":
            if self.tokens[self.at + 1] == "=":
                key = self.take()
                self.take("=")
                named[key] = self.expression(scope)
            else:
                given.append(self.expression(scope))
            if self.peek() == ",":
                self.take()
        self.take(")")
        return given, named

    def expression(self, scope: dict[str, Any]) -> Any:
        left = self.comparison(scope)
        if self.peek() == "?":
            self.take()
            yes = self.expression(scope)
            self.take(":")
            no = self.expression(scope)
            return yes if left else no
        return left

    def comparison(self, scope: dict[str, Any]) -> Any:
        left = self.sum(scope)
        if self.peek() in ("==", ">"):
            sign, right = self.take(), self.sum(scope)
            return left == right if sign == "==" else left > right
        return left

    def sum(self, scope: dict[str, Any]) -> Any:
        value = self.product(scope)
        while self.peek() in ("+", "-"):
            sign, right = self.take(), self.product(scope)
            value = _arithmetic(sign, value, right)
        return value

    def product(self, scope: dict[str, Any]) -> Any:
        value = self.unary(scope)
        while self.peek() in ("*", "/"):
            sign, right = self.take(), self.unary(scope)
            value = _arithmetic(sign, value, right)
        return value

    def unary(self, scope: dict[str, Any]) -> Any:
        if self.peek() == "-":
            self.take()
            return _arithmetic("*", -1.0, self.unary(scope))
        return self.primary(scope)

    def primary(self, scope: dict[str, Any]) -> Any:
        token = self.take()
        value: Any
        if token == "(":
            value = self.expression(scope)
            self.take(")")
        elif token == "[":
            value = []
            while self.peek() != "]":
                value.append(self.expression(scope))
                if self.peek() == ",":
                    self.take()
            self.take("]")
        elif token in _FUNCTIONS:
            given, _ = self.arguments(scope)
            value = _FUNCTIONS[token](*given)
        elif token[0].isdigit():
            value = float(token)
        else:
            value = scope[token]
        while self.peek() == "[":
            self.take()
            value = value[int(self.expression(scope))]
            self.take("]")
        return value


def _arithmetic(sign: str, a: Any, b: Any) -> Any:
    with np.errstate(all="ignore"):  # 0 / 0 is not an error there
        result = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide}[sign](a, b)
    return result.tolist()


def _union(solids: list[Solid]) -> Solid:
    return Solid.batch_boolean(solids, manifold3d.OpType.Add) if solids else Solid()


def _make(name: str, given: list[Any], named: dict[str, Any], children: list[Solid]) -> Solid:
    if name == "cube":
        return Solid.cube(given[0])
    if name == "cylinder":
        return Solid.cylinder(named["h"], named["r1"], named["r2"], int(named["$fn"]))
    if name == "polyhedron":
        points, faces = np.array(named["points"]), np.array(named["faces"], dtype=np.uint64)
        return Solid(manifold3d.Mesh64(points, np.ascontiguousarray(faces[:, ::-1])))
    if name == "translate":
        return _union(children).translate(given[0])
    if name == "rotate":
        return _union(children).rotate(given[0])
    if name == "multmatrix":
        return _union(children).transform(np.array(given[0])[:3])
    if name == "difference":
        return children[0] - _union(children[1:])
    raise AssertionError(f"{name}: not a part of the language that the reader knows")
