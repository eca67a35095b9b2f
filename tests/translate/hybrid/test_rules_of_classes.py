"""Rules of modification, inheritance, redeclaration and names,
by models whose values are worked out by hand."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from tests.translate.hybrid.test_hybrid_models import made, run

# What the rule says -> a model, whose state x is the time, and values at 2 s.
RULES: dict[str, tuple[str, dict[str, float]]] = {
    "the outer of two modifiers of one element holds": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B A a(k = 2); end B;
  model C extends B(a(k = 3)); end C;
  B b; B b5(a(k = 5)); C c; C c7(a(k = 7));
""",
        {"b.a.y": 4, "b5.a.y": 10, "c.a.y": 6, "c7.a.y": 14},
    ),
    "a modifier is evaluated where it stands": (
        """
model M
  parameter Real k = 10;
  model A parameter Real k = 1; parameter Real m = 2*k; Real y = m*time; end A;
  model B parameter Real k = 4; A a(k = k); A d(m = k); end B;
  A a(k = k); B b(k = 3); B c;
""",
        {"a.y": 40, "b.a.y": 12, "b.d.y": 6, "c.a.y": 16, "c.d.y": 8},
    ),
    "extends twice gives its modifiers to each level": (
        """
model M
  model A parameter Real k = 1; parameter Real m = 1; parameter Real n = 1;
    Real y = (k + 10*m + 100*n)*time; end A;
  model B extends A(k = 2, m = 2); end B;
  model C extends B(m = 3); end C;
  C c; C d(n = 4, m = 5); B b(k = 6);
""",
        {"c.y": 2 * 132, "d.y": 2 * 452, "b.y": 2 * 126},
    ),
    "start is modified at three levels": (
        """
model M
  model A Real z(start = 1, fixed = true); equation der(z) = 0; end A;
  model B A a(z(start = 2)); end B;
  model C B b(a(z(start = 3))); end C;
  A a; B b; C c; C d(b(a(z(start = 4)))); C e(b.a.z.start = 5);
""",
        {"a.z": 1, "b.a.z": 2, "c.b.a.z": 3, "d.b.a.z": 4, "e.b.a.z": 5},
    ),
    "start of a declaration is kept beside other modifiers": (
        """
model M
  model A parameter Real k = 1; Real z(start = 1.5, fixed = true); equation der(z) = k; end A;
  model B extends A(z(max = 100), k = 3); end B;
  A a(z(min = -5)); B b; B c(z.nominal = 2, z.start = 7);
""",
        {"a.z": 3.5, "b.z": 7.5, "c.z": 13},
    ),
    "arrays of components take arrays as modifiers, and each one value": (
        """
model M
  model A parameter Real k = 1; parameter Real v[2] = {1, 1}; Real y = (k + v[1] + 10*v[2])*time; end A;
  A a[2](k = {1, 2}); A b[3](each k = 4); A c[2](v = {{1, 2}, {3, 4}}); A d[2](each v = {5, 6}, k = {7, 8});
  parameter Integer n = 2;
  A e[n](k = {i*i for i in 1:n}); A f[2, 2](k = {{1, 2}, {3, 4}});
""",
        {
            "a[1].y": 24, "a[2].y": 26, "b[3].y": 30, "c[1].y": 44, "c[2].y": 88, "d[1].y": 144,
            "d[2].y": 146,
            "e[2].y": 30, "f[1,2].y": 26, "f[2,1].y": 28,
        },
    ),
    "arrays of components within arrays of components": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B A a[2](k = {2, 3}); end B;
  B b[2]; B e[2](each a(each k = 11));
""",
        {
            "b[1].a[1].y": 4, "b[2].a[2].y": 6, "e[2].a[1].y": 22,
        },
    ),
    "a redeclared component takes the modifiers of the redeclaration and of the constraining type": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B extends A; parameter Real m = 1; Real z = m*time; end B;
  model S replaceable A a(k = 2) constrainedby A(k = 3); replaceable A d constrainedby A(k = 4); end S;
  model T replaceable A a(k = 2); end T;
  S s; S r(redeclare B a(m = 5)); T t; T u(redeclare B a(m = 6)); T v(redeclare B a(k = 7, m = 8));
""",
        {"s.a.y": 4, "s.d.y": 8, "r.a.y": 6, "r.a.z": 10, "t.a.y": 4, "u.a.y": 4, "u.a.z": 12, "v.a.y": 14,
        "v.a.z": 16},
    ),
    "a redeclared model is used for all its components": (
        """
model M
  partial model P parameter Real k = 1; Real y; end P;
  model A extends P; equation y = k*time; end A;
  model B extends P; equation y = 10*k*time; end B;
  model S replaceable model Q = A constrainedby P; Q a; Q b(k = 2); end S;
  S s; S t(redeclare model Q = B); S u(redeclare model Q = B(k = 3));
  model V extends S(redeclare model Q = B(k = 4)); end V;
  V v;
""",
        {
            "s.a.y": 2, "s.b.y": 4, "t.a.y": 20, "t.b.y": 40, "u.a.y": 60, "u.b.y": 40, "v.a.y": 80,
            "v.b.y": 40,
        },
    ),
    "the outer of two redeclarations of a component holds": (
        """
model M
  model P parameter Real k = 1; Real y; end P;
  model A extends P; equation y = k*time; end A;
  model B extends P; equation y = 10*k*time; end B;
  model C extends P; equation y = 100*k*time; end C;
  model S replaceable A a(k = 2) constrainedby P; end S;
  model T extends S(redeclare replaceable B a); end T;
  model U extends T(redeclare replaceable C a); end U;
  T t; U u; U w(redeclare A a(k = 5)); T v(redeclare C a);
  model X extends U(redeclare A a(k = 3)); end X;
  X x1;
""",
        {"t.a.y": 20, "u.a.y": 200, "w.a.y": 10, "v.a.y": 200, "x1.a.y": 6},
    ),
    "a redeclaration reaches what the base inherits": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B parameter Real k = 1; Real y = 10*k*time; end B;
  model S replaceable A a; Real z = a.y; end S;
  model T extends S; Real w = 2*a.y; end T;
  model U extends T(redeclare B a(k = 3)); end U;
  T t; U u; T v(redeclare B a);
""",
        {"t.w": 4, "u.z": 60, "u.w": 120, "v.w": 40},
    ),
    "an element redeclares in the body of a class": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B parameter Real k = 1; Real y = 10*k*time; end B;
  model S replaceable A a; replaceable model Q = A; Q q; end S;
  model T extends S; redeclare B a(k = 2); redeclare model Q = B(k = 3); end T;
  S s; T t;
""",
        {"s.a.y": 2, "s.q.y": 2, "t.a.y": 40, "t.q.y": 60},
    ),
    "a redeclared array of components": (
        """
model M
  model A parameter Real k = 1; Real y = k*time; end A;
  model B extends A(k = 5); end B;
  model S replaceable A a[2](k = {2, 3}); end S;
  S s; S t(redeclare B a[2]); S u(redeclare B a[2](k = {7, 8}));
  model W extends S(redeclare replaceable B a[2](each k = 9)); end W;
  W w;
""",
        {"s.a[2].y": 6, "t.a[1].y": 4, "t.a[2].y": 6, "u.a[2].y": 16, "w.a[1].y": 18},
    ),
    "a redeclared function": (
        """
model M
  partial function F input Real u; output Real y; end F;
  function one extends F; algorithm y := u + 1; end one;
  function ten extends F; input Real k = 10; algorithm y := k*u; end ten;
  model S replaceable function f = one constrainedby F; Real y = f(time); end S;
  S s; S t(redeclare function f = ten); S u(redeclare function f = ten(k = 3));
  model V extends S(redeclare function f = ten(k = 4)); end V;
  V v;
""",
        {"s.y": 3, "t.y": 20, "u.y": 6, "v.y": 8},
    ),
    "packages with constants made of others": (
        """
package P
  package Base constant Real a = 2; constant Real b = 3*a; constant Real c[3] = {a, b, a*b}; end Base;
  package Own extends Base(a = 5); constant Real d = b + c[1] + c[2] + c[3]; end Own;
  package Half = Base(a = 1);
  model Q replaceable package N = Base; Real y = N.b*time; end Q;
  model M
    Real z1 = Base.b + Base.c[3]; Real z2 = Own.b + Own.c[3]; Real z3 = Own.d; Real z4 = Half.c[2];
    Q q(redeclare package N = Own);
    Q r(redeclare package N = Half);
@
end P;
""",
        {"z1": 18, "z2": 90, "z3": 15 + 5 + 15 + 75, "z4": 3, "q.y": 30, "r.y": 6},
    ),
    "all forms of import": (
        """
package P
  package A constant Real k = 3; package B constant Real m = 5; constant Real n = 7;
    function f input Real u; output Real y = u*n; end f; end B; end A;
  model M
    import P.A; import Q = P.A.B; import P.A.B.m; import P.A.B.{n, f};
    model Inner import P.A.B.*; Real y = m*n*time; end Inner;
    Inner inner_1;
    Real z1 = A.k; Real z2 = Q.m; Real z3 = m + n; Real z4 = f(time);
@
end P;
""",
        {"inner_1.y": 70, "z1": 3, "z2": 5, "z3": 12, "z4": 14},
    ),
    "an element hides one of an enclosing class, and a loop's index hides both": (
        """
model M
  constant Real k = 5; constant Integer i = 4;
  model A parameter Real k = 2; Real y = k*time; end A;
  model B Real y = k*time; end B;
  A a; B b; Real v[3]; Real s = sum(i*k for i in 1:3);
  encapsulated function f input Real k; output Real y; algorithm y := 3*k; end f;
  Real w = f(i);
equation
  for i in 1:3 loop v[i] = i*k*time; end for;
""",
        {"a.y": 4, "b.y": 10, "v[3]": 30, "s": 30, "w": 12},
    ),
    "inner and outer: the nearest inner, with its modifiers": (
        """
model M
  model World parameter Real g = 9; Real y = g*time; end World;
  model Body outer World world; Real y = world.g*time + world.y; end Body;
  model Box inner World world(g = 2); Body body; end Box;
  model Open Body body; end Open;
  inner World world(g = 4); Body body; Box box; Open open; Box box3(world(g = 3));
""",
        {"body.y": 16, "box.body.y": 8, "open.body.y": 16, "box3.body.y": 12},
    ),
    "an inner subtype and an outer parameter": (
        """
model M
  model World parameter Real g = 9; end World;
  model Moon extends World(g = 1.5); parameter Real h = 2; end Moon;
  model Body outer World world; outer parameter Real scale; Real y = scale*world.g*time; end Body;
  inner Moon world; inner parameter Real scale = 4; Body body;
""",
        {"body.y": 12},
    ),
    "conditional components, and connections to them": (
        """
model M
  connector O = output Real; connector I = input Real;
  model Source O y; parameter Real k = 1; equation y = k*time; end Source;
  model Sink I u; I extra if more; parameter Boolean more = false; Real z; protected I held; equation
    connect(extra, held); if not more then held = 7; end if; z = u + held; end Sink;
  Source s; Source t(k = 5) if true; Source none(k = 9) if false; Sink a; Sink b(more = true);
equation
  connect(s.y, a.u); connect(s.y, b.u); connect(t.y, b.extra); connect(none.y, b.extra);
""",
        {"a.z": 9, "b.z": 12},
    ),
    "short classes with modifiers, and types with attributes": (
        """
model M
  type Length = Real(unit = "m", start = 3); type Long = Length(start = 4);
    type Pair = Real[2](each start = 6);
  model A parameter Real k = 1; Length z(fixed = true); equation der(z) = k; end A;
  model B = A(k = 2); model C = B(z(start = 5)); model D = C(k = 3);
  A a; B b; C c; D d; Long l(fixed = true); Pair p(each fixed = true);
equation
  der(l) = 0; der(p) = {0, 1};
""",
        {"a.z": 5, "b.z": 7, "c.z": 9, "d.z": 11, "l": 4, "p[1]": 6, "p[2]": 8},
    ),
    "loops with nested and dependent ranges": (
        """
model M
  parameter Integer n = 3; Real a[n, n]; Real s = sum(a);
  Real w[5];
equation
  for i in 1:n loop
    for j in 1:i loop a[i, j] = 10*i + j; end for;
    for j in i + 1:n loop a[i, j] = -1; end for;
  end for;
  for i in 1:2:5 loop w[i] = i*time; end for;
  for i in 2:2:4 loop w[i] = -i; end for;
""",
        {"s": 11 + 21 + 22 + 31 + 32 + 33 - 3, "a[1,3]": -1, "w[3]": 6, "w[4]": -4},
    ),
    "if-equations by parameters, of unlike numbers of equations": (
        """
model M
  model A parameter Boolean on = true; parameter Integer mode = 1; Real y; Real z;
  equation if on and mode == 1 then y = time; z = 2*y; elseif mode == 2 then y = 5; z = 6; else y = z;
    z = 8; end if;
  end A;
  model B parameter Integer n = 2; Real v[n]; equation
    if n > 1 then v[1] = 3; for i in 2:n loop v[i] = v[i - 1]*2; end for; else v[1] = -1; end if; end B;
  A a; A b(on = false); A c(mode = 2); A d(on = false, mode = 2); B e; B f(n = 1); B g(n = 4);
""",
        {"a.z": 4, "b.y": 8, "c.y": 5, "d.z": 6, "e.v[2]": 6, "f.v[1]": -1, "g.v[4]": 24},
    ),
    "functions with default arguments, named arguments and records": (
        """
model M
  record R parameter Real a = 1; parameter Real b = 2*a; Real c[2] = {3, 4}; end R;
  record S extends R(a = 7); R r(b = 5); end S;
  function f input R r; input Real k = 10; input Real m = 2*k; output Real y; algorithm
    y := r.a + 10*r.b + 100*r.c[2] + k*m; end f;
  function g input Real k; output R r; algorithm r := R(a = k, b = 3, c = {k, 2*k}); end g;
  R r(a = 2); S s; parameter R q = R(a = 4, b = 5, c = {6, 7});
  Real y1 = f(r, k = 1); Real y2 = f(q, m = 0); Real y3 = f(R(1, 2, {3, 4}), 1, 1);
    Real y4 = s.b + s.r.b + s.a;
  Real y5 = f(g(5), 0);
""",
        {"y1": 2 + 40 + 400 + 2, "y2": 4 + 50 + 700, "y3": 422, "y4": 14 + 5 + 7, "y5": 1035},
    ),
    "final elements, and modifiers of records that are passed on": (
        """
model M
  record D parameter Real k = 1; parameter Real m = 2; end D;
  record E = D(k = 3); record F extends E(m = 4); end F;
  model A parameter D d; final parameter Real p = d.k*d.m; Real y = p*time; end A;
  model B parameter D d = F(); A a(d = d); A b(d = E(m = 10)); A c(d(k = 5)); end B;
  A a; A e(d = F(k = 6)); A f(d.m = 9); B b; B g(d(k = 7, m = 8)); B h(d = D(2, 2));
""",
        {"a.y": 4, "e.y": 48, "f.y": 18, "b.a.y": 24, "b.b.y": 60, "b.c.y": 20, "h.a.y": 8},
    ),
    "a class that extends takes the connectors and connections of its base": (
        """
model M
  connector P Real v; flow Real i; end P;
  partial model Two P p; P n; Real v = p.v - n.v; Real i = p.i; equation p.i + n.i = 0; end Two;
  model R extends Two; parameter Real r = 1; equation v = r*i; end R;
  model Source extends Two; replaceable function f = c; function c input Real t; output Real u;
    algorithm u := 6; end c;
  equation v = f(time); end Source;
  model Ground P p; equation p.v = 0; end Ground;
  function ramp input Real t; output Real u; algorithm u := 3*t; end ramp;
  partial model Circuit replaceable Two load constrainedby Pins;
    Source s(redeclare replaceable function f = ramp); Ground g; equation
    connect(s.p, load.p); connect(s.n, load.n); connect(s.n, g.p); end Circuit;
  partial model Pins P p; P n; end Pins;
  model Both extends Pins; R a(r = 1); R b(r = 3); equation connect(p, a.p); connect(a.n, n); connect(p, b.p);
    connect(b.n, n); end Both;
  model C1 extends Circuit(redeclare R load(r = 2)); end C1; model C2 extends Circuit(redeclare Both load);
    end C2;
  C1 one; C2 two;
""",
        {"one.load.i": 3, "two.load.p.i": 8},
    ),
    "a protected and an inherited name of one class twice by two bases": (
        """
model M
  model A parameter Real k = 2; Real y = k*time; end A;
  model B extends A; Real z = y + k; end B;
  model C extends A; Real w = y - k; end C;
  model D extends B(k = 3); extends C(k = 3); end D;
  D d;
""",
        {"d.y": 6, "d.z": 9, "d.w": 3},
    ),
    "enumerations: as parameters, indices and conditions": (
        """
model M
  type Kind = enumeration(slow, fast, off);
  model A parameter Kind kind = Kind.fast; parameter Real v[Kind] = {1, 5, 9}; Real y = v[kind]*time;
    Real z = if kind == Kind.off then 1 else 2; Integer n = Integer(kind); end A;
  A a; A b(kind = Kind.off); A c(kind = Kind.slow, v = {4, 3, 2});
""",
        {"a.y": 10, "b.y": 18, "b.z": 1, "c.y": 8, "a.n": 2},
    ),
    "parameters that size arrays, modified from outside": (
        """
model M
  model A parameter Integer n = 2; parameter Real v[:] = ones(n); Real y = sum(v)*time;
    Real z[n] = fill(1.5, n);
    parameter Integer m = size(v, 1); Real w[m] = 2*v; end A;
  A a; A b(n = 3); A c(v = {1, 2, 3, 4}); A d[2](n = {1, 3}); A e(n = 4, v = 1:4);
""",
        {"a.y": 4, "b.y": 6, "b.z[3]": 1.5, "c.y": 20, "c.w[4]": 8, "d[2].z[3]": 1.5, "e.w[3]": 6},
    ),
    "packages replaced at two levels": (
        """
package P
  partial package Medium constant Real cp; constant Real rho = 1000;
    replaceable partial function h input Real T;
    output Real y; end h; end Medium;
  package Water extends Medium(cp = 4); redeclare function extends h algorithm y := cp*T; end h; end Water;
  package Hot extends Water(rho = 900); redeclare function h input Real T; output Real y;
    algorithm y := 10*cp*T; end h;
  end Hot;
  model Pipe replaceable package Medium = Water constrainedby P.Medium; Real y = Medium.h(time)*Medium.rho;
    end Pipe;
  model Plant replaceable package Medium = Water; Pipe pipe(redeclare package Medium = Medium); end Plant;
  model M
    Plant plant(redeclare package Medium = Hot);
@
end P;
""",
        {"plant.pipe.y": 10 * 4 * 2 * 900},
    ),
    "modifiers of components within redeclared classes": (
        """
model M
  model Gain parameter Real k = 1; input Real u; output Real y = k*u; end Gain;
  model Double extends Gain(k = 2); end Double;
  model Controller replaceable Gain gain(k = 5) constrainedby Gain; input Real u = time; end Controller;
  model Loop Controller c(gain(k = 7), gain.u = 3*time); end Loop;
  model Other extends Loop(c(redeclare Double gain)); end Other;
  model Third extends Loop(c(redeclare Double gain(k = 9))); end Third;
  Loop loop1; Other other; Third third;
""",
        {"loop1.c.gain.y": 42, "other.c.gain.y": 42, "third.c.gain.y": 54},
    ),
    "constants of enclosing packages and of classes of components": (
        """
package P
  constant Real k = 3;
  package Q constant Real k = 4; constant Real m = 2*P.k; constant Real both[2] = {k, m};
    model A constant Real c = k + 1; Real y = (k + m + c)*time; Real z = both[1] + both[2]; end A; end Q;
  model M
    Q.A a; Real y = k*time + Q.k + Q.both[2]; Real w = a.c;
@
end P;
""",
        {"a.y": 30, "a.z": 10, "y": 16, "w": 5},
    ),
    "functions of one name in several classes": (
        """
model M
  function f input Real u; output Real y; algorithm y := 7*u; end f;
  model S function f input Real u; output Real y; algorithm y := u + 1; end f; Real y = f(time); end S;
  model T function f input Real u; output Real y; algorithm y := 10*u; end f; parameter Real k = f(1);
    Real y = f(time); Real z[2]; equation for i in 1:2 loop z[i] = f(i); end for; end T;
  model U extends S; Real w = f(f(time)); T t(k = f(2)); end U;
  S s; T t; U u; Real y = f(time);
""",
        {"s.y": 3, "t.y": 20, "t.z[2]": 20, "t.k": 10, "u.y": 3, "u.w": 4, "u.t.k": 3, "y": 14},
    ),
    "functions of one name in several packages": (
        """
package P
  package A function f input Real u; output Real y; algorithm y := u + 1; end f;
    function g input Real u; output Real y; algorithm y := 2*f(u); end g;
    model S parameter Real k = f(0); Real y = f(time); Real z = g(time); end S; end A;
  package B function f input Real u; output Real y; algorithm y := 10*u; end f;
    function g input Real u; output Real y; algorithm y := 3*f(u); end g;
    model S extends A.S; Real w = f(time) + k; Real v = g(time); end S; end B;
  model M
    A.S s; B.S t;
@
end P;
""",
        {"s.y": 3, "s.z": 6, "t.y": 3, "t.z": 6, "t.w": 21, "t.v": 60},
    ),
    "a function and a model that a class redeclares with a body": (
        """
model M
  model S replaceable function f input Real u; output Real y; algorithm y := u + 1; end f;
    replaceable model Q Real z = 5; end Q; Q q; Real y = f(time); end S;
  model T extends S; redeclare function f input Real u; output Real y; algorithm y := 10*u; end f;
    redeclare model Q Real z = k; parameter Real k = 6; end Q; Real w = f(3); end T;
  S s; T t;
""",
        {"s.y": 3, "s.q.z": 5, "t.y": 20, "t.q.z": 6, "t.w": 30},
    ),
    "partial packages completed by others, with functions and models": (
        """
package P
  partial package Medium constant Real cp = 1; replaceable partial function h input Real T; output Real y;
    end h;
    replaceable model Props Real d = cp; end Props; end Medium;
  package Water extends Medium(cp = 4); redeclare function extends h algorithm y := cp*T; end h; end Water;
  package Oil extends Medium(cp = 2); redeclare function extends h algorithm y := 10*cp*T; end h;
    end Oil;
  model Pipe replaceable package Medium = Water constrainedby P.Medium; Real y = Medium.h(time);
    Medium.Props props; end Pipe;
  model Pair replaceable package M1 = Water constrainedby Medium;
    replaceable package M2 = Oil constrainedby Medium;
    Pipe a(redeclare package Medium = M1); Pipe b(redeclare package Medium = M2); Pipe c; end Pair;
  model M
    Pair one; Pair two(redeclare package M1 = Oil);
      Pair three(redeclare package M2 = Water, redeclare package M1 = Oil);
@
end P;
""",
        {
            "one.a.y": 8, "one.b.y": 40, "one.c.y": 8, "two.a.y": 40, "two.b.y": 40, "two.c.y": 8,
            "three.a.y": 40,
            "three.b.y": 8, "one.a.props.d": 4, "two.a.props.d": 2, "three.b.props.d": 4,
        },
    ),
    "an heir modifies an element of an element that its base modifies": (
        """
model M
  model A parameter Real k = 1; parameter Real m = 1; Real z(start = 2, fixed = true);
    equation der(z) = k + 10*m;
  end A;
  model L constant Real c = 5; A a(k = 7, z(start = 3)); parameter Real p = 2;
    A d(z(start = p, max = f(c))); end L;
  function f input Real u; output Real y; algorithm y := 1000*u; end f;
  model T extends L(a(z(min = -1), m = 0)); end T;
  model U extends T(a.z.nominal = 5, a.k = 8, d(z(min = 0, each fixed = true), m = 2)); end U;
  L l(a(z(min = -1))); T t; U u(p = 4);
  model B A a[2](k = {3, 4}); end B;
  model C B b(a(z(start = {5, 6}))); end C;
  model D extends C(b(a(each z(min = -9), each m = 0))); end D;
  D d; model E = C(b(a(each m = 1))); E e;
""",
        {
            "l.a.z": 3 + 34, "t.a.z": 3 + 14, "u.a.z": 3 + 16, "u.d.z": 4 + 42, "d.b.a[2].z": 6 + 8,
            "d.b.a[1].z": 5 + 6, "e.b.a[2].z": 6 + 28,
        },
    ),
    "a record that is bound as a whole loses its modifiers": (
        """
model M
  record P parameter Real a = 1; parameter Real b = 2; end P; record P3 = P(a = 3);
  constant Real c = 4; constant Real d = 6;
  model A parameter P p(a = 3); Real y = p.a*10 + p.b; end A;
  model B parameter P p(a = c, b = c + 1), q(b = d); Real y = p.a*10 + p.b + 1000*q.b; end B;
  parameter P r(a = 9); parameter P3 q3; A a(p = r); A b(p = P(7, 8)); A c1(p(b = 5)); A d1(p = P()); A e;
    A f(p = q3);
  model A2 extends A(p = P(5, 6)); end A2; A2 a2; A g(p = P3(b = 7)); B h; B i(p = P(1, 1)); A j(p.b = 0);
""",
        {
            "a.y": 92, "b.y": 78, "c1.y": 35, "d1.y": 12, "e.y": 32, "f.y": 32, "a2.y": 56, "g.y": 37,
            "h.y": 6045, "i.y": 6011, "j.y": 30
        },
    ),
    "records within records, bound one by one and in arrays": (
        """
model M
  record P parameter Real a = 1; parameter Real b = 2; end P;
  record Q P p(a = 3); parameter Real c = p.a + p.b; end Q;
  model A parameter Q q[2]; Real y = q[1].c + 10*q[2].p.a; end A;
  A a; A b(q(p(b = {5, 6}))); A d(q = {Q(p = P(1, 1)), Q(p = P(7, 8), c = 2)}); parameter Q r(p(a = 9));
    A e(q = {r, r});
  Q f[2](p(a = {1, 2}, each b = 4));
""",
        {
            "a.y": 35, "b.y": 38, "d.y": 72, "e.y": 101, "f[2].c": 6
        },
    ),
    "two bases with one component each modified": (
        """
model M
  model P parameter Real k = 1; Real y = k*time; end P;
  model A P p(k = 2); Real a = p.y; end A; model B P q(k = 3); Real b = q.y; end B;
  model C extends A(p(k = 4)); extends B(q.k = 5); end C; model D extends C(p(k = 6), q(k = 7)); end D;
  C c; D d; D e(p.k = 8);
""",
        {
            "c.a": 8, "c.b": 10, "d.a": 12, "d.b": 14, "e.a": 16
        },
    ),
    "parameters depending on others modified in heirs": (
        """
model M
  model A parameter Real m = 2; parameter Real w = 3; final parameter Real k = m*w^2;
    parameter Real x0 = k/2; Real x(start = x0, fixed = true); equation der(x) = k; end A;
  model B extends A(w = m + 1); end B; model C A a(m = 5); B b(x0 = 1); end C;
  A a; B b; C c; B d(m = 1, x.start = 100);
""",
        {
            "a.x": 45, "b.x": 45, "c.a.x": 112.5, "c.b.x": 37, "d.x": 108
        },
    ),
    "arrays passed through three levels": (
        """
model M
  model A parameter Integer n = 1; parameter Real k[n] = ones(n); Real y[n] = k*time; end A;
  model B parameter Integer n = 2; parameter Real k[n] = 2*ones(n); A a(n = n, k = k); end B;
  model C B b[2](each n = 3, k = {{1, 2, 3}, {4, 5, 6}}); B d(n = 1); end C;
  C c; B e(k = {7, 8}); B f(n = 3, a.k = {1, 1, 5});
""",
        {
            "c.b[2].a.y[3]": 12, "c.d.a.y[1]": 4, "e.a.y[2]": 16, "f.a.y[3]": 10
        },
    ),
    "modification of inherited array component element start": (
        """
model M
  model A Real x[3](start = {1, 2, 3}, each fixed = true); equation der(x) = zeros(3); end A;
  model B extends A(x(start = {4, 5, 6})); end B; model C extends A(x(each start = 7)); end C;
    model D B b(x(start = fill(8, 3))); C c[2](x(start = {{1, 2, 3}, {4, 5, 6}})); end D;
  A a; B b; C c; D d;
""",
        {
            "a.x[2]": 2, "b.x[2]": 5, "c.x[3]": 7, "d.b.x[1]": 8, "d.c[2].x[3]": 6
        },
    ),
    "records in arrays of components, with each": (
        """
model M
  record D parameter Real k = 1; parameter Real v[2] = {1, 2}; end D;
  model A parameter D d; Real y = d.k*d.v[2]*time; end A; model B A a[2](d(k = {3, 4}, each v = {5, 6}));
    end B;
  B b; A c(d(v = {7, 8})); model E extends A(d(k = 9)); end E; E e(d(v = {1, 10}));
    A f[2](each d = D(2, {3, 4}));
""",
        {
            "b.a[2].y": 48, "c.y": 16, "e.y": 180, "f[1].y": 16
        },
    ),
    "parameters of parameters, across three levels": (
        """
model M
  model A parameter Real k = 1; parameter Real m = k + 1; parameter Real n = m*k; Real y = n; end A;
  model B parameter Real k = 5; A a(k = k + 1, n = a.m + k); end B;
  parameter Real k = 100; B b; B c(a(k = k)); B d(k = 2, a.n = 3*d.a.k);
""",
        {
            "b.a.y": 12, "c.a.y": 106, "d.a.y": 9
        },
    ),
    "inner and outer through two levels and arrays": (
        """
model M
  model W parameter Real g = 1; Real t = g*time; end W;
  model B outer W w; Real y = w.t; end B;
  model C B b[2]; inner W w(g = 5); end C;
  model D C c; B b; end D;
  inner W w(g = 3); D d; D e[2];
""",
        {
            "d.c.b[2].y": 10, "d.b.y": 6, "e[2].b.y": 6, "e[1].c.b[1].y": 10
        },
    ),
    "parameters without fixed values, and starts, of components": (
        """
model M
  model A parameter Real k(fixed = false, start = 1); Real x(start = 2, fixed = true); equation der(x) = k;
    end A;
  A a; A b(x(start = 3)); A c(k(fixed = true) = 4);
initial equation
  a.k = 5; b.k*2 = a.k + b.x;
""",
        {
            "a.x": 12, "b.x": 11, "c.x": 10
        },
    ),
    "replaceable types and records": (
        """
model M
  model S replaceable type T = Real; T x(start = 1, fixed = true);
    replaceable record D parameter Real k = 2; end D; D d; parameter Real z = d.k; equation der(x) = z; end S;
  type Own = Real(start = 7, unit = "m"); record Big parameter Real k = 5; parameter Real m = 1; end Big;
  S s; S t(redeclare type T = Own); S u(redeclare record D = Big); S v(redeclare record D = Big(k = 6));
    S w(d(k = 9));
""",
        {
            "s.x": 5, "u.x": 11, "v.x": 13, "w.x": 19
        },
    ),
    "imports within packages, functions and bases": (
        """
package P
  package C constant Real pi = 3; constant Integer n = 2; constant Real t[n] = {1.5, 2.5}; end C;
  package F import P.C.pi; import K = P.C; function area input Real r; output Real a;
    algorithm a := pi*r^2 + K.t[K.n]; end area; constant Real two = 2*pi; end F;
  type Len = Real(unit = "m");
  model Base import P.F.*; Real y = area(time); parameter Real q = two; end Base;
  model M
    extends Base(q = 1); import P.C; Real z = C.n*C.t[1]; Base b; C2 c; model C2 constant Real pi = 4;
      Real y = pi + F.two; end C2;
@
end P;
""",
        {
            "y": 14.5, "q": 1, "z": 3, "b.q": 6, "c.y": 10
        },
    ),
    "functions of one name with loops of unknown length": (
        """
model M
  model A function f input Real u; output Real y; algorithm y := u; while y > 3 loop y := y - 1; end while;
    end f; Real y = f(time*5); end A;
  model B function f input Real u; output Real y; algorithm y := u; while y > 3 loop y := y - 2; end while;
    end f; Real y = f(time*5); end B;
  A a; B b;
""",
        {
            "a.y": 3, "b.y": 2
        },
    ),
    "one discrete signal connected to several elements": (
        """
model M
  connector BI = input Boolean; connector BO = output Boolean; connector II = input Integer;
  connector IO = output Integer;
  model S BO y; IO k; parameter Integer n = 3; equation y = time > 0.5; k = if y then n else 1; end S;
  model A parameter Integer n = 2; BI u[n]; II k[3]; BO y; Integer s; equation y = u[1] and u[n];
    s = sum(k); end A;
  model B S s; A a(n = 3); BO y; equation connect(a.y, y); connect(s.y, a.u[1]); connect(s.y, a.u[2]);
    connect(a.u[3], s.y); connect(s.k, a.k[1]); connect(s.k, a.k[3]); connect(s.k, a.k[2]); end B;
  B b; B c(s(n = 5)); Real x(start = 0, fixed = true);
equation
  der(x) = if b.y then 1 else 0;
""",
        {"x": 1.5, "b.a.s": 9, "c.a.s": 15},
    ),
    "outer variables of built-in types": (
        """
model M
  type T = Real(unit = "m");
  model Sub outer T shared; outer Boolean on; Real y = shared + (if on then 1 else 0); end Sub;
  model Mid inner T shared = 5*time; Sub s; end Mid;
  partial model Ctl parameter Real ref = 1; Real u; outer Real meas; end Ctl;
  model P extends Ctl; parameter Real k = 2; equation u = k*(ref - meas); end P;
  model Plant replaceable P c(ref = 5) constrainedby Ctl(ref = 3);
    inner Real meas; equation meas = 1; end Plant;
  inner T shared = time; inner Boolean on = time > 0.5; Sub s; Mid m; Plant plant;
  Plant other(redeclare P c(k = 10));
""",
        {"s.y": 3, "m.s.y": 11, "plant.c.u": 8, "other.c.u": 20},
    ),
}  # fmt: skip


def completed(text: str) -> str:
    """A model with a state, which is the time."""
    at = text.find("@")
    body, after = (text[:at], text[at + 1 :]) if at >= 0 else (text, "")
    last = body[body.rindex("model M") :]
    section = "" if any(line.startswith("equation") for line in last.splitlines()) else "equation\n"
    return f"{body}{section}  der(clock) = 1;\n  end M;\n{after}".replace(
        "model M\n", "model M\n  Real clock(start = 0, fixed = true);\n", 1
    )


@pytest.mark.parametrize("rule", RULES)
def test_values_of_the_rule(tmp_path, rule):
    text, expected = RULES[rule]
    model = "P.M" if text.lstrip().startswith("package") else "M"
    fmu = made(tmp_path, completed(text), model=model)
    found = run(fmu, 2.0, 1.0, *expected)
    last = {name: found[name][-1] for name in expected}
    assert last == pytest.approx(expected, abs=1e-9)
    assert all(math.isfinite(value) for value in last.values())


PARTS = """
package Parts
  partial package Med constant Real k = 0; replaceable partial function h input Real u; output Real y;
  end h; end Med;
  package Water extends Med(k = 1); redeclare function extends h algorithm y := u; end h; end Water;
  package Oil extends Med(k = 2); redeclare function extends h algorithm y := 10*u; end h; end Oil;
  model Pipe replaceable package Medium = Water constrainedby Med; Real y = Medium.k*time;
    Real z = Medium.h(time);
  end Pipe;
  model A parameter Real k = 1; parameter Real m = 1; Real y = k*10 + m; end A; model B A a; end B;
  model L B b(a(k = 7)); end L;
  model F1 function f input Real u; output Real y; algorithm y := u; end f; Real y = f(time); end F1;
  model F2 function f input Real u; output Real y; algorithm y := 10*u; end f; Real y = f(time); end F2;
  model S replaceable model Q = A; Q q; end S; model S2 extends S(redeclare model Q = A(k = 4)); end S2;
end Parts;
"""


def test_classes_of_a_library(tmp_path):
    library = tmp_path / "library" / "Parts"
    library.mkdir(parents=True)
    (library / "package.mo").write_text(PARTS)
    text = completed("""
model M
  Parts.Pipe one(redeclare package Medium = Parts.Oil); Parts.Pipe other;
  Parts.F1 f1; Parts.F2 f2; Parts.S2 s2;
  model T extends Parts.L(b(a(m = 9))); end T; T t; Parts.S s(redeclare model Q = Parts.A(k = 3));
""")  # fmt: skip
    fmu = made(tmp_path, text, libraries=[library.parent])
    expected = {
        "one.y": 4, "one.z": 20, "other.y": 2, "other.z": 2, "f1.y": 2, "f2.y": 20, "s.q.y": 31, "s2.q.y": 41,
        "t.b.a.y": 79,
    }  # fmt: skip
    found = run(fmu, 2.0, 1.0, *expected)
    assert {name: found[name][-1] for name in expected} == pytest.approx(expected, abs=1e-9)
