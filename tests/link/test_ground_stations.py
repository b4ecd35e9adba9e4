"""MAVSDK and MAVProxy, as they are, against a simulated flight: find the companion, read and change its parameters, fly a mission by command."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import lcm
import noctule_lcm
import pytest
from ground_scene import COMPANION, EXPLORING, LANDED, LANDING, PAUSED, RETURNING, SYSTEM, SimulatedFlight, wait_for

from noctule import params_gen

MISSION_START, PAUSE_CONTINUE, RETURN, LAND = 300, 193, 20, 21


def test_mavsdk_finds_reads_changes_and_flies(tmp_path):
    mavsdk = pytest.importorskip("mavsdk")
    from mavsdk.plugins.component_metadata import ComponentMetadata
    from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
    from mavsdk.plugins.param import Param, ParamError

    with SimulatedFlight(tmp_path) as flight:
        station = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
        try:
            station.add_any_connection(f"udpin://127.0.0.1:{flight.port}")
            vehicle = station.first_autopilot(30.0)
            assert vehicle is not None
            assert wait_for(lambda: COMPANION in vehicle.component_ids(), 20.0)
            direct = MavlinkDirect(vehicle)
            values, texts = {}, []

            def on_value(message, _):
                fields = json.loads(message.fields_json)
                values[fields["name"].rstrip("\0")] = fields["value"]

            direct.subscribe_message("NAMED_VALUE_FLOAT", on_value)
            direct.subscribe_message("STATUSTEXT", lambda message, _: texts.append(json.loads(message.fields_json)["text"]))

            # Parameters, with their metadata.
            metadata, found = ComponentMetadata(vehicle), {}
            metadata.subscribe_metadata_available(lambda update, _: found.setdefault(int(update.type), update))
            metadata.request_component(COMPANION)
            assert wait_for(lambda: 1 in found, 30.0)
            described = {p["name"]: p for p in json.loads(metadata.get_metadata(COMPANION, 1).json_metadata)["parameters"]}
            assert described["SPEED_MAX"]["units"] == "m/s" and described["SPEED_MAX"]["max"] == params_gen.BY_NAME["speed_max_m_s"].max
            parameters = Param(vehicle)
            try:
                parameters.select_component(COMPANION, 0)
            except ParamError as said:                              # MAVSDK 4.1.0 obeys, and answers UNKNOWN; what is read below is the companion's
                assert "UNKNOWN" in str(said)
            expected = {(row.param, row.type == "int") for row in params_gen.TABLE}

            def listed():                                           # overheard values of the autopilot may take the place of ours: then again
                table = parameters.get_all_params()
                return {(p.name, False) for p in table.float_params} | {(p.name, True) for p in table.int_params}

            assert any(expected <= listed() for _ in range(5))
            parameters.set_param_float("SPEED_MAX", 0.75)
            assert parameters.get_param_float("SPEED_MAX") == 0.75
            parameters.set_param_int("LNK_OBSTACLES", 0)
            assert parameters.get_param_int("LNK_OBSTACLES") == 0
            try:
                parameters.set_param_float("SPEED_MAX", 99.0)
            except ParamError:
                pass
            assert wait_for(lambda: any("SPEED_MAX refused" in text for text in texts), 5.0)
            assert parameters.get_param_float("SPEED_MAX") == 0.75

            # A mission by command.
            def order(command, param1=0.0):
                fields = {"target_system": SYSTEM, "target_component": COMPANION, "command": command, "confirmation": 0, "param1": param1,
                          "param2": 0.0, "param3": 0.0, "param4": 0.0, "param5": 0.0, "param6": 0.0, "param7": 0.0}
                ack = direct.send_command(MavlinkMessage(message_name="COMMAND_LONG", system_id=0, component_id=0, target_system_id=SYSTEM,
                                                         target_component_id=COMPANION, fields_json=json.dumps(fields)))
                return json.loads(ack.fields_json)["result"]

            def state():
                return values.get("nav_state")

            assert order(PAUSE_CONTINUE) == 1                       # temporarily rejected: no mission is under way
            assert wait_for(lambda: values.get("nav_ready") == 1.0, 60.0)
            assert wait_for(lambda: order(MISSION_START) == 0, 30.0), texts
            assert wait_for(lambda: state() == EXPLORING, 60.0), texts
            assert order(PAUSE_CONTINUE, 0.0) == 0
            assert wait_for(lambda: state() == PAUSED, 20.0)
            assert order(PAUSE_CONTINUE, 1.0) == 0
            assert wait_for(lambda: state() == EXPLORING, 20.0)
            assert values["area_m2"] > 1.0 and 0.0 < values["explored"] <= 1.0 and values["quality"] > 0.0 and values["floor"] == 0.0
            assert order(RETURN) == 0 and order(RETURN) == 0        # a repeat is answered alike
            assert wait_for(lambda: state() in (RETURNING, LANDING, LANDED), 20.0)
            assert order(LAND) == 0
            assert wait_for(lambda: any("disarmed" in text for text in texts), 90.0), texts
        finally:
            station.destroy()


def test_mavsdk_finds_the_front_camera_and_its_stream(tmp_path):
    mavsdk = pytest.importorskip("mavsdk")
    from mavsdk.plugins.camera import Camera, VideoStreamInfo

    with SimulatedFlight(tmp_path) as flight:
        bus, video, stop = lcm.LCM(flight.camera_url), noctule_lcm.video_t(), threading.Event()
        video.running, video.port, video.width_px, video.height_px, video.rate_hz, video.bit_rate = 1, 5600, 320, 240, 5.0, 400000

        def tell():                                                 # as noctule-video does
            while not stop.wait(0.5):
                bus.publish("VIDEO", video.encode())

        teller = threading.Thread(target=tell)
        teller.start()
        station = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
        try:
            station.add_any_connection(f"udpin://127.0.0.1:{flight.port}")
            vehicle = station.first_autopilot(30.0)
            assert vehicle is not None
            camera = Camera(vehicle)
            assert wait_for(lambda: camera.camera_list().cameras, 30.0)
            found = camera.camera_list().cameras
            assert [(c.vendor_name, c.model_name, c.horizontal_resolution_px) for c in found] == [("Noctule", "front camera", 320)]
            camera.subscribe_video_stream_info(lambda *_: None)     # asks for it

            def stream():
                return camera.get_video_stream_info(found[0].component_id)

            assert wait_for(lambda: stream().status == VideoStreamInfo.VideoStreamStatus.IN_PROGRESS, 30.0)
            assert wait_for(lambda: stream().settings.uri == "5600", 30.0)      # the status may come before
            assert (stream().settings.frame_rate_hz, stream().settings.bit_rate_b_s) == (5.0, 400000)
        finally:
            stop.set()
            teller.join()
            station.destroy()


def test_mavproxy_reads_changes_and_flies(tmp_path):
    program = Path(sys.executable).parent / "mavproxy.py"
    if not program.exists():
        pytest.skip("MAVProxy is not installed")
    with SimulatedFlight(tmp_path, flavour="ardupilot") as flight:
        proxy = subprocess.Popen([sys.executable, str(program), "--master", f"udpin:127.0.0.1:{flight.port}", "--target-system", str(SYSTEM),
                                  "--target-component", str(COMPANION), "--default-modules", "param,cmdlong,misc", "--state-basedir", str(tmp_path)],
                                 stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1,
                                 env={**os.environ, "HOME": str(tmp_path), "TERM": "dumb"}, cwd=tmp_path)
        heard = []
        reader = threading.Thread(target=lambda: heard.extend(iter(proxy.stdout.readline, "")), daemon=True)
        reader.start()

        def said(words, begin=0):
            return any(words in line for line in heard[begin:])

        def tell(line):
            proxy.stdin.write(line + "\n")
            proxy.stdin.flush()

        def order(line, words, seconds=20.0, tries=3):
            for _ in range(tries):
                begin = len(heard)
                tell(line)
                if wait_for(lambda: said(words, begin), seconds):
                    return True
            return False

        try:
            assert wait_for(lambda: said("Received") and said("parameters"), 60.0) or order("param fetch", "Received", 30.0), "".join(heard[-20:])
            assert order("param show SPEED_MAX", "SPEED_MAX"), "".join(heard[-20:])
            tell("param set SPEED_MAX 0.75")                        # says nothing when it went well
            assert order("param show SPEED_MAX", "0.75", 3.0, tries=5), "".join(heard[-20:])
            assert order("param set SPEED_MAX 99", "SPEED_MAX refused", 10.0), "".join(heard[-20:])
            assert order("long MISSION_START", "start accepted", 10.0, tries=8), "".join(heard[-20:])
            assert wait_for(lambda: said("exploring"), 90.0), "".join(heard[-20:])
            assert order("long DO_PAUSE_CONTINUE 0", "paused: pause ordered"), "".join(heard[-20:])
            assert order("long DO_PAUSE_CONTINUE 1", "resume ordered"), "".join(heard[-20:])
            assert order("long NAV_RETURN_TO_LAUNCH", "returning home: return ordered"), "".join(heard[-20:])
            assert order("long NAV_LAND", "landing"), "".join(heard[-20:])
            assert wait_for(lambda: said("disarmed"), 90.0), "".join(heard[-20:])
        finally:
            proxy.kill()
            proxy.wait(10)
