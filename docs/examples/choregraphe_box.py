"""The script of a Choregraphe box (NAOqi up to 2.8): paste it into a Python box that has its outputs.

Outputs, each of type bang: onStroke, onPat, onOther. The box receives touchd's event while it is loaded.
"""


class MyClass(GeneratedClass):  # noqa: F821
    """Fires an output for each gesture that touchd reports."""

    def __init__(self):
        GeneratedClass.__init__(self)  # noqa: F821

    def onLoad(self):
        self.subscriber = self.session().service("ALMemory").subscriber("TouchGesture/Gesture")
        self.link = self.subscriber.signal.connect(self.on_gesture)

    def onUnload(self):
        self.subscriber.signal.disconnect(self.link)

    def on_gesture(self, gesture):
        if gesture == "stroke":
            self.onStroke()
        elif gesture == "pat":
            self.onPat()
        elif gesture:
            self.onOther()
