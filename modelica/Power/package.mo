within ;
package Power "Areas of a power grid"
  annotation (
    version="0.1.0",
    Documentation(info="<html>
<p>Load-frequency control in deviations per unit, as textbooks have it. The package needs no library, not even the
Modelica Standard Library.</p>
</html>"));
end Power;
