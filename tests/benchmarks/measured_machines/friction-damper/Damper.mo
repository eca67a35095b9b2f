model Damper "A damper with Coulomb friction alone, moved by a testing machine"
  parameter Real level(unit="N", min=0) = 10000 "Friction force";
  parameter Real width(unit="m/s", min=0) = 1e-3 "Speed at which the rounded-off friction reaches 71 % of the level";
  input Real travel(unit="m", start=0) "At which the machine holds the damper; Coulomb friction does not depend on it";
  input Real rate(unit="m/s", start=0) "Its rate";
  output Real force(unit="N") "With which the machine has to move the damper";
equation
  force = level*rate/sqrt(rate*rate + width*width) + 0*travel;
end Damper;
