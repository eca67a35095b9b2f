within Processes;
model LevelControl "PI control of a level by a pump"
  parameter Real gain(unit="V/m", min=0) = 20 "Voltage per error of the level";
  parameter Real reset_time(quantity="Time", unit="s", min=0) = 60 "Time constant of the integral part";
  input Real reference(quantity="Length", unit="m", start=0.2) "Level asked for";
  input Real level(quantity="Length", unit="m", start=0) "Level measured";
  output Real voltage(unit="V") "Of the pump";
  output Real integral(unit="V", start=9.90285, fixed=true) "Integral part of the voltage";
equation
  der(integral) = gain/reset_time*(reference - level);
  voltage = gain*(reference - level) + integral;
  assert(reset_time > 0, "reset_time is 0 s; allowed: above 0 s");
  annotation (Documentation(info="<html>
<p>u = K (h_r - h) + v, v' = K/T (h_r - h).</p>
</html>"));
end LevelControl;
