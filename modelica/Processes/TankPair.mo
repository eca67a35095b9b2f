within Processes;
model TankPair "A pump fills a tank that drains into a second one"
  parameter Real area(quantity="Area", unit="m2", min=0) = 0.01 "Of the surface of either tank";
  parameter Real orifice(quantity="Area", unit="m2", min=0) = 0.00005 "Of the outlet of either tank";
  parameter Real flow_per_voltage(unit="m3/(s.V)", min=0) = 0.00001 "Gain of the pump";
  input Real voltage(unit="V", start=0) "Of the pump";
  output Real upper(quantity="Length", unit="m", start=0.2, fixed=true, min=0) "Level of the tank that is filled";
  output Real lower(quantity="Length", unit="m", start=0.2, fixed=true, min=0) "Level of the other tank";
protected
  constant Real g(quantity="Acceleration", unit="m/s2") = 9.80665;
  Real between(unit="m3/s") "Flow from tank to tank";
  Real out(unit="m3/s") "Flow from the other tank";
equation
  between = orifice*sqrt(2*g*noEvent(max(upper, 1e-6)));
  out = orifice*sqrt(2*g*noEvent(max(lower, 1e-6)));
  area*der(upper) = flow_per_voltage*voltage - between;
  area*der(lower) = between - out;
  assert(area > 0, "area is 0 m2; allowed: above 0 m2");
  annotation (Documentation(info="<html>
<p>A h_1' = k u - a sqrt(2 g h_1), A h_2' = a sqrt(2 g h_1) - a sqrt(2 g h_2): Torricelli's law.</p>
</html>"));
end TankPair;
