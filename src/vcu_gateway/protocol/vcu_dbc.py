"""Protocol that cantools reads in dbc/vcu.dbc.

Made by `vcu-gateway dbc`; do not change it here.

`protocol.dbc` takes it where the SHA-256 of the DBC in use is this one.
"""

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec

# fmt: off
SHA256 = "50a9c70a326d6f65751c7e1f1496a9b62d8d571f19fca858a102af7a2d6ee230"
PROTOCOL = ProtocolSpec(
    nodes={"VCU": 208, "BMS": 244, "IMU": 121, "ARD2": 146, "PCU1": 167, "PCU2": 168},
    messages=(
        MessageSpec(
            name="ARD2_SteeringWheel", can_id=0x040AD092, sender="ARD2", receivers=("VCU",), period_ms=100, comment="Steering angle and front wheel speeds. The source: Arduino2方向盤轉角訊號/輪速1/輪速2",
            signals=(
                SignalSpec(name="SteeringAngle", start_bit=0, length_bits=16, minimum=-90.0, maximum=90.0, factor=0.003, offset=-90.0, unit="deg", comment="方向盤轉角"),
                SignalSpec(name="WheelSpeedFL", start_bit=16, length_bits=16, minimum=0.0, maximum=65.535, factor=0.001, unit="km/h", saturated_raw=65535, comment="輪速FL; raw 65535 means at or above 65.535 km/h (E4)"),
                SignalSpec(name="WheelSpeedFR", start_bit=32, length_bits=16, minimum=0.0, maximum=65.535, factor=0.001, unit="km/h", saturated_raw=65535, comment="輪速FR; raw 65535 means at or above 65.535 km/h (E4)"),
            ),
        ),
        MessageSpec(
            name="BMS_Status", can_id=0x1808D0F4, sender="BMS", receivers=("VCU",), period_ms=500, comment="Pack voltage, state of charge, fault levels, life signal. The source: BMS1 (pack voltage/pack current/soc/6~8放電狀態)",
            signals=(
                SignalSpec(name="PackVoltage", start_bit=0, length_bits=16, minimum=0.0, maximum=100.0, factor=0.01, unit="V", comment="Pack Voltage"),
                SignalSpec(name="SOC", start_bit=32, length_bits=8, minimum=0.0, maximum=100.0, unit="%", comment="SOC; State of charge"),
                SignalSpec(name="CellOvervoltage", start_bit=40, length_bits=2, minimum=0.0, maximum=3.0, names={0: "normal", 1: "level1", 2: "level2", 3: "level3"}, comment="電池電壓過充狀態"),
                SignalSpec(name="CellUndervoltage", start_bit=42, length_bits=2, minimum=0.0, maximum=3.0, names={0: "normal", 1: "level1", 2: "level2", 3: "level3"}, comment="電池電壓過低狀態"),
                SignalSpec(name="DischargeOvercurrent", start_bit=46, length_bits=2, minimum=0.0, maximum=2.0, names={0: "normal", 1: "level1", 2: "level2", 3: "reserved"}, comment="放電過流狀態; Level 1 reads like a slip for discharge current: both regeneration and motor power are limited (E7)"),
                SignalSpec(name="TemperatureImbalance", start_bit=48, length_bits=2, minimum=0.0, maximum=2.0, names={0: "normal", 1: "level1", 2: "level2", 3: "reserved"}, comment="電池溫度不均衡狀態"),
                SignalSpec(name="Overtemperature", start_bit=50, length_bits=2, minimum=0.0, maximum=2.0, names={0: "normal", 1: "level1", 2: "level2", 3: "reserved"}, comment="溫度過高狀態"),
                SignalSpec(name="Undertemperature", start_bit=52, length_bits=2, minimum=0.0, maximum=2.0, names={0: "normal", 1: "level1", 2: "level2", 3: "reserved"}, comment="電池低溫狀態"),
                SignalSpec(name="VoltageImbalance", start_bit=54, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "level1"}, comment="電池電壓不均衡狀態"),
                SignalSpec(name="InternalFault", start_bit=55, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "level2"}, comment="BMS內部(自檢)故障"),
                SignalSpec(name="BatteryState", start_bit=56, length_bits=2, minimum=0.0, maximum=2.0, names={0: "idle", 1: "charging", 2: "discharging", 3: "reserved"}, comment="電池狀態"),
                SignalSpec(name="ErrorCode", start_bit=58, length_bits=5, minimum=0.0, maximum=31.0, comment="錯誤碼; reserved for an error code: passed through raw"),
                SignalSpec(name="LifeSignal", start_bit=63, length_bits=1, minimum=0.0, maximum=1.0, comment="BMS CAN生命信號; toggles on every frame"),
            ),
        ),
        MessageSpec(
            name="BMS_Temperatures", can_id=0x1809D0F4, sender="BMS", receivers=("VCU",), period_ms=500, comment="Temperatures of the five packs. The source: BMS(pack T 1~5/保留)",
            signals=(
                SignalSpec(name="PackTemperature1", start_bit=0, length_bits=8, minimum=-50.0, maximum=200.0, offset=-50.0, unit="degC", comment="Pack#01溫度"),
                SignalSpec(name="PackTemperature2", start_bit=8, length_bits=8, minimum=-50.0, maximum=200.0, offset=-50.0, unit="degC", comment="Pack#02溫度"),
                SignalSpec(name="PackTemperature3", start_bit=16, length_bits=8, minimum=-50.0, maximum=200.0, offset=-50.0, unit="degC", comment="Pack#03溫度"),
                SignalSpec(name="PackTemperature4", start_bit=24, length_bits=8, minimum=-50.0, maximum=200.0, offset=-50.0, unit="degC", comment="Pack#04溫度"),
                SignalSpec(name="PackTemperature5", start_bit=32, length_bits=8, minimum=-50.0, maximum=200.0, offset=-50.0, unit="degC", comment="Pack#05溫度"),
            ),
        ),
        MessageSpec(
            name="IMU_Acceleration", can_id=0x040AD079, sender="IMU", receivers=("VCU",), period_ms=10, comment="Acceleration. The source: IMU訊號(加速度); its identifier needs 30 bits (E2)",
            signals=(
                SignalSpec(name="AccelerationX", start_bit=0, length_bits=16, minimum=-78.48, maximum=78.48, factor=0.01, offset=-78.48, unit="m/s2", comment="ax"),
                SignalSpec(name="AccelerationY", start_bit=16, length_bits=16, minimum=-78.48, maximum=78.48, factor=0.01, offset=-78.48, unit="m/s2", comment="ay"),
                SignalSpec(name="AccelerationZ", start_bit=32, length_bits=16, minimum=-78.48, maximum=78.48, factor=0.01, offset=-78.48, unit="m/s2", comment="az"),
            ),
        ),
        MessageSpec(
            name="IMU_AngularRate", can_id=0x040BD079, sender="IMU", receivers=("VCU",), period_ms=10, comment="Angular rate (E8). The source: IMU訊號(角加速度); its identifier needs 30 bits (E2)",
            signals=(
                SignalSpec(name="AngularRateX", start_bit=0, length_bits=16, minimum=-245.0, maximum=245.0, factor=0.0078125, offset=-245.0, unit="deg/s", comment="gx"),
                SignalSpec(name="AngularRateY", start_bit=16, length_bits=16, minimum=-245.0, maximum=245.0, factor=0.0078125, offset=-245.0, unit="deg/s", comment="gy"),
                SignalSpec(name="AngularRateZ", start_bit=32, length_bits=16, minimum=-245.0, maximum=245.0, factor=0.0078125, offset=-245.0, unit="deg/s", comment="gz"),
            ),
        ),
        MessageSpec(
            name="IMU_Attitude", can_id=0x040CD079, sender="IMU", receivers=("VCU",), period_ms=10, comment="Attitude. The source: IMU訊號(姿態); its identifier needs 30 bits (E2), a second one stands beside it (E3)",
            signals=(
                SignalSpec(name="AttitudeX", start_bit=0, length_bits=16, minimum=-85.0, maximum=85.0, factor=0.058, offset=-85.0, unit="deg", comment="mx"),
                SignalSpec(name="AttitudeY", start_bit=16, length_bits=16, minimum=-85.0, maximum=85.0, factor=0.058, offset=-85.0, unit="deg", comment="my"),
                SignalSpec(name="AttitudeZ", start_bit=32, length_bits=16, minimum=-85.0, maximum=85.0, factor=0.058, offset=-85.0, unit="deg", comment="mz"),
            ),
        ),
        MessageSpec(
            name="PCU1_Status1", can_id=0x0808D0A7, sender="PCU1", receivers=("VCU",), period_ms=500, comment="Controller state, sent by itself every 500 ms. The source: 馬達控制器狀態B state1",
            signals=(
                SignalSpec(name="PowerMode", start_bit=2, length_bits=2, minimum=0.0, maximum=3.0, names={0: "eco", 1: "normal", 2: "turbo", 3: "safety"}, comment="動力模式"),
                SignalSpec(name="MotorReverse", start_bit=4, length_bits=1, minimum=0.0, maximum=1.0, names={0: "forward", 1: "reverse"}, comment="電機反轉"),
                SignalSpec(name="RegenBrake", start_bit=5, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="煞車回收"),
                SignalSpec(name="PowerCut", start_bit=7, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "cut"}, comment="斷電"),
                SignalSpec(name="Throttle", start_bit=8, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="油門踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="Brake", start_bit=16, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="煞車踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="VoltageLevel", start_bit=24, length_bits=3, minimum=1.0, maximum=5.0, names={1: "under_minimum", 2: "minimum_to_low", 3: "low_to_high", 4: "high_to_maximum", 5: "over_maximum"}, comment="Voltage_Level"),
                SignalSpec(name="CurrentLevel", start_bit=27, length_bits=2, minimum=0.0, maximum=2.0, names={0: "eco", 1: "normal", 2: "turbo"}, comment="Current_Level"),
                SignalSpec(name="TemperatureProtectLevel", start_bit=29, length_bits=2, minimum=0.0, maximum=2.0, names={0: "good", 1: "turbo_disabled", 2: "motor_shutdown"}, comment="Temperature Protect Level"),
                SignalSpec(name="FocMode", start_bit=31, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="FOC Mode"),
                SignalSpec(name="StatusCode", start_bit=32, length_bits=16, minimum=0.0, maximum=65535.0, comment="控制器狀態碼; the vendor's table is not in the source: names come from the configuration"),
                SignalSpec(name="ControllerTemperature", start_bit=48, length_bits=8, minimum=0.0, maximum=150.0, unit="degC", comment="控制器溫度"),
                SignalSpec(name="MotorTemperature", start_bit=56, length_bits=8, minimum=0.0, maximum=255.0, unit="degC", comment="馬達溫度"),
            ),
        ),
        MessageSpec(
            name="PCU2_Status1", can_id=0x0808D0A8, sender="PCU2", receivers=("VCU",), period_ms=500, comment="Controller state, sent by itself every 500 ms. The source: 馬達控制器狀態B state1",
            signals=(
                SignalSpec(name="PowerMode", start_bit=2, length_bits=2, minimum=0.0, maximum=3.0, names={0: "eco", 1: "normal", 2: "turbo", 3: "safety"}, comment="動力模式"),
                SignalSpec(name="MotorReverse", start_bit=4, length_bits=1, minimum=0.0, maximum=1.0, names={0: "forward", 1: "reverse"}, comment="電機反轉"),
                SignalSpec(name="RegenBrake", start_bit=5, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="煞車回收"),
                SignalSpec(name="PowerCut", start_bit=7, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "cut"}, comment="斷電"),
                SignalSpec(name="Throttle", start_bit=8, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="油門踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="Brake", start_bit=16, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="煞車踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="VoltageLevel", start_bit=24, length_bits=3, minimum=1.0, maximum=5.0, names={1: "under_minimum", 2: "minimum_to_low", 3: "low_to_high", 4: "high_to_maximum", 5: "over_maximum"}, comment="Voltage_Level"),
                SignalSpec(name="CurrentLevel", start_bit=27, length_bits=2, minimum=0.0, maximum=2.0, names={0: "eco", 1: "normal", 2: "turbo"}, comment="Current_Level"),
                SignalSpec(name="TemperatureProtectLevel", start_bit=29, length_bits=2, minimum=0.0, maximum=2.0, names={0: "good", 1: "turbo_disabled", 2: "motor_shutdown"}, comment="Temperature Protect Level"),
                SignalSpec(name="FocMode", start_bit=31, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="FOC Mode"),
                SignalSpec(name="StatusCode", start_bit=32, length_bits=16, minimum=0.0, maximum=65535.0, comment="控制器狀態碼; the vendor's table is not in the source: names come from the configuration"),
                SignalSpec(name="ControllerTemperature", start_bit=48, length_bits=8, minimum=0.0, maximum=150.0, unit="degC", comment="控制器溫度"),
                SignalSpec(name="MotorTemperature", start_bit=56, length_bits=8, minimum=0.0, maximum=255.0, unit="degC", comment="馬達溫度"),
            ),
        ),
        MessageSpec(
            name="PCU1_Status2", can_id=0x0809D0A7, sender="PCU1", receivers=("VCU",), period_ms=50, comment="Controller's reply to every command. The source: 馬達控制器狀態A state2 (接收VCU的指令後回覆此訊息)",
            signals=(
                SignalSpec(name="BatteryVoltage", start_bit=0, length_bits=16, minimum=0.0, maximum=511.99, factor=0.0078125, unit="V", comment="電池電壓"),
                SignalSpec(name="BatteryCurrent", start_bit=16, length_bits=16, minimum=-2048.0, maximum=2047.9375, signed=True, factor=0.0625, unit="A", comment="電池電流; two's complement (E9)"),
                SignalSpec(name="PhaseCurrent", start_bit=32, length_bits=16, minimum=-2048.0, maximum=2047.9375, signed=True, factor=0.0625, unit="A", comment="馬達相電流; two's complement (E9)"),
                SignalSpec(name="MotorSpeed", start_bit=48, length_bits=16, minimum=0.0, maximum=6000.0, unit="rpm", comment="電機轉速; values beyond 6000 are kept and marked (E11)"),
            ),
        ),
        MessageSpec(
            name="PCU2_Status2", can_id=0x0809D0A8, sender="PCU2", receivers=("VCU",), period_ms=50, comment="Controller's reply to every command. The source: 馬達控制器狀態A state2 (接收VCU的指令後回覆此訊息)",
            signals=(
                SignalSpec(name="BatteryVoltage", start_bit=0, length_bits=16, minimum=0.0, maximum=511.99, factor=0.0078125, unit="V", comment="電池電壓"),
                SignalSpec(name="BatteryCurrent", start_bit=16, length_bits=16, minimum=-2048.0, maximum=2047.9375, signed=True, factor=0.0625, unit="A", comment="電池電流; two's complement (E9)"),
                SignalSpec(name="PhaseCurrent", start_bit=32, length_bits=16, minimum=-2048.0, maximum=2047.9375, signed=True, factor=0.0625, unit="A", comment="馬達相電流; two's complement (E9)"),
                SignalSpec(name="MotorSpeed", start_bit=48, length_bits=16, minimum=0.0, maximum=6000.0, unit="rpm", comment="電機轉速; values beyond 6000 are kept and marked (E11)"),
            ),
        ),
        MessageSpec(
            name="VCU_PCU1_Command", can_id=0x0008A7D0, sender="VCU", receivers=("PCU1",), period_ms=50, comment="Command to a motor controller. The source: 馬達控制器控制指令(VCU每50ms主動送出)",
            signals=(
                SignalSpec(name="PowerMode", start_bit=2, length_bits=2, minimum=0.0, maximum=3.0, names={0: "eco", 1: "normal", 2: "turbo", 3: "safety"}, comment="動力模式"),
                SignalSpec(name="MotorReverse", start_bit=4, length_bits=1, minimum=0.0, maximum=1.0, names={0: "forward", 1: "reverse"}, comment="電機反轉"),
                SignalSpec(name="RegenBrake", start_bit=5, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="煞車回收"),
                SignalSpec(name="PowerCut", start_bit=7, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "cut"}, comment="斷電"),
                SignalSpec(name="Throttle", start_bit=8, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="油門踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="Brake", start_bit=16, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="煞車踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="SpeedLimit", start_bit=32, length_bits=16, minimum=0.0, maximum=12000.0, unit="rpm", comment="轉速限制量"),
                SignalSpec(name="PowerLimit", start_bit=48, length_bits=16, minimum=0.0, maximum=60000.0, unit="W", comment="功率限制量"),
            ),
        ),
        MessageSpec(
            name="VCU_PCU2_Command", can_id=0x0008A8D0, sender="VCU", receivers=("PCU2",), period_ms=50, comment="Command to a motor controller. The source: 馬達控制器控制指令(VCU每50ms主動送出)",
            signals=(
                SignalSpec(name="PowerMode", start_bit=2, length_bits=2, minimum=0.0, maximum=3.0, names={0: "eco", 1: "normal", 2: "turbo", 3: "safety"}, comment="動力模式"),
                SignalSpec(name="MotorReverse", start_bit=4, length_bits=1, minimum=0.0, maximum=1.0, names={0: "forward", 1: "reverse"}, comment="電機反轉"),
                SignalSpec(name="RegenBrake", start_bit=5, length_bits=1, minimum=0.0, maximum=1.0, names={0: "off", 1: "on"}, comment="煞車回收"),
                SignalSpec(name="PowerCut", start_bit=7, length_bits=1, minimum=0.0, maximum=1.0, names={0: "normal", 1: "cut"}, comment="斷電"),
                SignalSpec(name="Throttle", start_bit=8, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="油門踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="Brake", start_bit=16, length_bits=8, minimum=0.0, maximum=99.45, factor=0.39, unit="%", comment="煞車踏板; 100 % would be raw 256.4: encoding saturates at 255 (E10)"),
                SignalSpec(name="SpeedLimit", start_bit=32, length_bits=16, minimum=0.0, maximum=12000.0, unit="rpm", comment="轉速限制量"),
                SignalSpec(name="PowerLimit", start_bit=48, length_bits=16, minimum=0.0, maximum=60000.0, unit="W", comment="功率限制量"),
            ),
        ),
    ),
)
