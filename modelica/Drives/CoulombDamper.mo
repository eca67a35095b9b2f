within Drives;
model CoulombDamper "Damper with Coulomb friction alone"
  parameter Real level(quantity="Force", unit="N", min=0) = 1000 "Friction force";
  parameter Real width(quantity="Velocity", unit="m/s", min=0) = 1e-4
    "Speed at which the rounded-off friction reaches 71 % of the level";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity at which the damper is moved";
  output Real force(quantity="Force", unit="N") "Force with which it has to be moved";
equation
  // noEvent: rounded off, the law has no corner.
  force = noEvent(level*velocity/sqrt(velocity*velocity + width*width));
  assert(width > 0, "width is 0 m/s; allowed: above 0 m/s, such as 0.1 mm/s");
  annotation (Documentation(info="<html>
<p>F = F_c v/sqrt(v^2 + v_w^2): Coulomb friction with its corner rounded off. Nothing sticks: below v_w the
damper creeps.</p>
</html>"));
end CoulombDamper;
